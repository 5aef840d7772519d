"""Recordings: what is written is read, by this and by other readers; misuse is refused."""

import threading
from pathlib import Path

import numpy as np
import pytest

import transport
from tests.transport.recorded import CALIBRATION, scan_record, write_recording
from transport import MessageError, RecordingError
from transport.recording import (
    FrameRecord,
    FrameReference,
    RecordingWriter,
    open_recording,
    recover_recording,
)
from transport.recording.topic_file import TopicFile


def test_scans_come_back_as_they_were_recorded(tmp_path: Path, peer) -> None:
    """Scans, stripes with lost and shared frames, postures, grids and calibration survive the file."""
    pictures = write_recording(tmp_path / "a.mcap", peer)
    with open_recording(tmp_path / "a.mcap") as recording:
        assert recording.calibration == CALIBRATION
        assert [scan.step for scan in recording.scans] == [0, 1]
        for scan in recording.scans:
            wanted = scan_record(peer, scan.step)
            for name in ("robot", "mode", "stamp", "stance", "calibration_hash"):
                assert getattr(scan, name) == getattr(wanted, name), name
            assert scan.is_whole and scan.stance_end == peer.make_stance()
            assert [stripe.index for stripe in scan.stripes] == [0, 2, 4, 6, 8]
            assert [stripe.mirror_angle for stripe in scan.stripes] == [0.1 * i for i in range(5)]
            assert scan.stripes[3].on is None and scan.stripes[4].off is None
            assert scan.stripes[0].off == scan.stripes[1].off
            for i in (0, 1, 2, 4):
                np.testing.assert_array_equal(recording.frame(scan.stripes[i].on).pixels, pictures[i + 1])
            np.testing.assert_array_equal(recording.frame(scan.stripes[0].off).pixels, pictures[0])
        assert [terrain.sequence for terrain in recording.terrains()] == [1, 2]
        assert all(peer.is_whole(terrain) for terrain in recording.terrains("map"))


def test_an_attachment_is_written_under_the_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No other thread may add or flush meanwhile: its record would begin inside the attachment's."""
    free: list[bool] = []

    def try_lock() -> None:
        free.append(file._lock.acquire(blocking=False))
        if free[-1]:
            file._lock.release()

    def add_attachment(*_: object) -> None:
        thread = threading.Thread(target=try_lock)
        thread.start()
        thread.join()

    with TopicFile(tmp_path / "a.mcap", "guara") as file:
        monkeypatch.setattr(file._writer, "add_attachment", add_attachment)
        file.attach("notes", "text/plain", b"")
    assert free == [False]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_every_kind_of_pixels_round_trips(tmp_path: Path, peer, dtype: type, shape: tuple) -> None:
    """Grey and colour, eight and sixteen bits, contiguous or not, come back bit for bit."""
    pixels = np.random.default_rng(1).integers(0, 256, (*shape[:1], 14, *shape[2:])).astype(dtype)[:, ::2]
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        writer.begin_scan(scan_record(peer))
        writer.add_stripe(0, 0.0, FrameRecord(pixels=pixels, stamp=9))
        writer.end_scan()
    with open_recording(tmp_path / "a.mcap") as recording:
        frame = recording.frame(recording.scans[0].stripes[0].on)
    assert frame.pixels.dtype == dtype and frame.stamp == 9
    np.testing.assert_array_equal(frame.pixels, pixels)


def test_picture_files_are_kept_byte_by_byte(tmp_path: Path, peer) -> None:
    """A compressed frame is stored as it is; raw and compressed frames may share a scan."""
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        writer.begin_scan(scan_record(peer))
        writer.add_stripe(0, 0.0, FrameRecord(data=b"\xff\xd8 picture", format="jpeg"))
        writer.add_stripe(1, 0.1, FrameRecord(pixels=np.zeros((2, 2), np.uint8)), FrameRecord(data=b"x", format="png"))
        writer.end_scan()
    with open_recording(tmp_path / "a.mcap") as recording:
        first, second = recording.scans[0].stripes
        assert recording.frame(first.on).data == b"\xff\xd8 picture"
        assert recording.frame(second.off).format == "png"
        assert recording.frame(second.on).pixels.shape == (2, 2)


@pytest.mark.slow
def test_a_second_reader_opens_the_file(tmp_path: Path, peer) -> None:
    """The MCAP reader of rosbags, another implementation, finds topics, schemas and messages by the file alone."""
    from rosbags.highlevel import AnyReader

    write_recording(tmp_path / "a.mcap", peer)
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        assert kinds["/guara/terrain"] == "guara_msgs/msg/Terrain"
        assert kinds["/guara/camera/on"] == "sensor_msgs/msg/Image"
        names = [c for c in reader.connections if c.topic == "/guara/terrain"]
        found = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(names)]
    assert [message.sequence for message in found] == [1, 2]


def test_messages_of_other_topics_are_kept(tmp_path: Path, peer) -> None:
    """Occupancy and stance pauses are recorded too; a message on a wrong topic is refused."""
    grid = transport.occupancy_message(np.zeros((2, 3), np.int8), 0.1, (0, 0), "f", peer.STAMP)
    pause = transport.StancePause(robot="guara", step=2, phase=1, stamp=7, stance=peer.make_stance())
    status = transport.Status(stamp=9, items=(transport.StatusItem(name="scanner", level=transport.Health.OK),))
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        writer.add_messages([("occupancy", grid)])
        writer.add_stance_pause(pause)
        writer.add_status(transport.encode_status(status))
        writer.add_messages([("/robot_description", transport.text_message("<robot/>"))])
        with pytest.raises(RecordingError, match="'grid_map' does not accept nav_msgs/msg/OccupancyGrid"):
            writer.add_messages([("grid_map", grid)])
    with open_recording(tmp_path / "a.mcap") as recording:
        assert [message.info.width for message in recording.messages("occupancy")] == [3]
        assert [found.step for found in recording.stance_pauses()] == [2]
        assert [found.status[0].name for found in recording.messages("status")] == ["scanner"]
        assert [found.data for found in recording.messages("/robot_description")] == ["<robot/>"]
        assert recording.scans == () and recording.calibration is None
        with pytest.raises(RecordingError, match="topic 'x' is unknown"):
            next(recording.messages("x"))
        with pytest.raises(RecordingError, match="topic 'x' is unknown"):
            next(recording.written("x"))
        with pytest.raises(RecordingError, match="extent is 'x'"):
            next(recording.terrains("x"))
        with pytest.raises(RecordingError, match="contains no frame"):
            recording.frame(FrameReference("/guara/camera/on", 1))


def test_log_time_is_the_order_of_writing(tmp_path: Path, peer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Times of writing, never going back though the clock does; frames keep their stamps, and are found by them."""
    from mcap.reader import make_reader

    clock = iter([50, 60, 40, *range(70, 200)])
    monkeypatch.setattr("transport.recording.topic_file.time.time_ns", lambda: next(clock))
    pictures = write_recording(tmp_path / "a.mcap", peer)
    with (tmp_path / "a.mcap").open("rb") as file:
        found = [(c, m) for _, c, m in make_reader(file).iter_messages(log_time_order=False)]
    times = [message.log_time for _, message in found]
    assert times[:3] == [50, 60, 60] and times == sorted(times) and times[-1] < 200
    stamps = [message.publish_time for channel, message in found if channel.topic == "/guara/camera/on"]
    assert len(set(stamps)) == len(stamps) == 8 and min(stamps) >= peer.STAMP
    with open_recording(tmp_path / "a.mcap") as recording:
        last = recording.scans[1].stripes[4]
        np.testing.assert_array_equal(recording.frame(last.on).pixels, pictures[5])


def test_every_channel_says_how_it_was_offered(tmp_path: Path, peer) -> None:
    """MCAP's profile ros2 asks for it; rosbags, another reader, understands it. Grids are latched, frames are not."""
    from rosbags.highlevel import AnyReader

    write_recording(tmp_path / "a.mcap", peer)
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        offered = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    assert all(len(profiles) == 1 for profiles in offered.values()) and len(offered) == 7
    assert {profile.reliability.name for (profile,) in offered.values()} == {"RELIABLE"}
    durable = {topic for topic, (profile,) in offered.items() if profile.durability.name == "TRANSIENT_LOCAL"}
    assert durable == {"/guara/terrain", "/guara/map"}


def test_recordings_of_earlier_versions_are_read(tmp_path: Path, peer) -> None:
    """There log_time was the stamp, went back and forth, and no channel had metadata."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    pictures = write_recording(tmp_path / "new.mcap", peer)
    with (tmp_path / "new.mcap").open("rb") as new, (tmp_path / "old.mcap").open("wb") as old:
        writer = Writer(old, chunk_size=64 * 1024)
        writer.start(profile="ros2")
        ids: dict[str, int] = {}
        for schema, channel, message in make_reader(new).iter_messages(log_time_order=False):
            if channel.topic not in ids:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.topic] = writer.register_channel(channel.topic, "cdr", schema_id)
            is_frame = "camera" in channel.topic
            stamp = message.publish_time if is_frame else peer.STAMP + (7 * message.log_time) % 10**9
            writer.add_message(ids[channel.topic], stamp, message.data, stamp)
        writer.finish()
    with open_recording(tmp_path / "old.mcap") as recording:
        assert [scan.is_whole for scan in recording.scans] == [True, True]
        for scan in recording.scans:
            for i in (0, 1, 2, 4):
                np.testing.assert_array_equal(recording.frame(scan.stripes[i].on).pixels, pictures[i + 1])
        assert [terrain.sequence for terrain in recording.terrains()] == [1, 2]


def test_misuse_is_refused_in_words(tmp_path: Path, peer) -> None:
    """Wrong order, existing or missing files, folders and closed recordings each have their message."""
    path = tmp_path / "a.mcap"
    writer = RecordingWriter(path)
    with pytest.raises(RecordingError, match="no scan is open"):
        writer.add_stripe(0, 0.0, None)
    with pytest.raises(RecordingError, match="no scan is open"):
        writer.end_scan()
    writer.begin_scan(scan_record(peer))
    with pytest.raises(RecordingError, match="scan of step 3 is still open"):
        writer.begin_scan(scan_record(peer))
    writer.close()
    writer.close()
    with pytest.raises(RecordingError, match="is closed"):
        writer.add_terrain(peer.make_terrain())
    with pytest.raises(RecordingError, match="exists; give another name"):
        RecordingWriter(path)
    with pytest.raises(RecordingError, match="cannot write"):
        RecordingWriter(tmp_path / "none" / "a.mcap")
    with pytest.raises(RecordingError, match="cannot read"):
        open_recording(tmp_path / "none.mcap")
    with pytest.raises(RecordingError, match="exists; give another name"):
        recover_recording(path, path)
    with pytest.raises(RecordingError, match="cannot recover"):
        recover_recording(tmp_path / "none.mcap", tmp_path / "b.mcap")
    (tmp_path / "text.mcap").write_text("no recording")
    with pytest.raises(RecordingError, match="is not an MCAP file"):
        recover_recording(tmp_path / "text.mcap", tmp_path / "b.mcap")
    with open_recording(path) as recording:
        assert [scan.is_whole for scan in recording.scans] == [False]


@pytest.mark.parametrize(
    ("fields", "expected_text"),
    [
        ({}, "either pixels or the bytes"),
        ({"pixels": np.zeros((2, 2), np.uint8), "data": b"x"}, "either pixels or the bytes"),
        ({"data": b"x", "format": "gif"}, "format of a frame is 'gif'; allowed: 'jpeg', 'png'"),
        ({"pixels": np.zeros((2, 2))}, "float64 of shape"),
        ({"pixels": np.zeros((2, 2, 4), np.uint8)}, r"shape \(2, 2, 4\)"),
        ({"pixels": np.zeros((2, 2, 1), np.uint8)}, r"shape \(2, 2, 1\)"),
        ({"pixels": np.zeros((0, 2), np.uint8)}, r"shape \(0, 2\)"),
    ],
)
def test_a_wrong_frame_is_refused(fields: dict, expected_text: str) -> None:
    """Only pictures that can be read back are taken."""
    with pytest.raises(MessageError, match=expected_text):
        FrameRecord(**fields)
