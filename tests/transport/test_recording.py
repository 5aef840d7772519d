"""Tests of recordings: what is written is read, what was acknowledged survives, what was cut is mended."""

from pathlib import Path

import numpy as np
import pytest

import transport
from transport import MessageError, RecordingError
from transport.recording import (
    FrameRecord,
    FrameReference,
    RecordingWriter,
    ScanRecord,
    open_recording,
    recover_recording,
)

CALIBRATION = b'{"format": "guara-calibration/1"}'


def _scan(peer, step: int = 3) -> ScanRecord:
    return ScanRecord(
        robot="guara",
        mode="coarse",
        stamp=peer.STAMP + step * 10**9,
        step=step,
        stance=peer.make_stance(),
        calibration_hash="abc",
    )


def _pictures() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.integers(0, 256, (48, 64, 3)).astype(np.uint8) for _ in range(6)]


def _write(path: Path, peer, scans: int = 2, **options: object) -> list[np.ndarray]:
    pictures = _pictures()
    with RecordingWriter(path, calibration=CALIBRATION, **options) as writer:
        for step in range(scans):
            writer.begin_scan(_scan(peer, step))
            off = writer.add_frame(FrameRecord(pixels=pictures[0]), laser_on=False)
            for i in range(5):
                on = None if i == 3 else FrameRecord(pixels=pictures[i + 1])
                writer.add_stripe(2 * i, 0.1 * i, on, None if i == 4 else off)
            writer.end_scan(stance_end=peer.make_stance())
            writer.add_terrain(peer.make_terrain(step + 1))
            writer.add_terrain(peer.make_terrain(step + 1, extent="map", shape=(14, 32)))
    return pictures


def test_scans_come_back_as_they_were_recorded(tmp_path: Path, peer) -> None:
    """Scans, stripes with lost and shared frames, postures, grids and calibration survive the file."""
    pictures = _write(tmp_path / "a.mcap", peer)
    with open_recording(tmp_path / "a.mcap") as recording:
        assert recording.calibration == CALIBRATION
        assert [scan.step for scan in recording.scans] == [0, 1]
        for scan in recording.scans:
            wanted = _scan(peer, scan.step)
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


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_every_kind_of_pixels_round_trips(tmp_path: Path, peer, dtype: type, shape: tuple) -> None:
    """Grey and colour, eight and sixteen bits, contiguous or not, come back bit for bit."""
    pixels = np.random.default_rng(1).integers(0, 256, (*shape[:1], 14, *shape[2:])).astype(dtype)[:, ::2]
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        writer.begin_scan(_scan(peer))
        writer.add_stripe(0, 0.0, FrameRecord(pixels=pixels, stamp=9))
        writer.end_scan()
    with open_recording(tmp_path / "a.mcap") as recording:
        frame = recording.frame(recording.scans[0].stripes[0].on)
    assert frame.pixels.dtype == dtype and frame.stamp == 9
    np.testing.assert_array_equal(frame.pixels, pixels)


def test_picture_files_are_kept_byte_by_byte(tmp_path: Path, peer) -> None:
    """A compressed frame is stored as it is; raw and compressed frames may share a scan."""
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        writer.begin_scan(_scan(peer))
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

    _write(tmp_path / "a.mcap", peer)
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
        writer.add_message("occupancy", grid)
        writer.add_stance_pause(pause)
        writer.add_status(transport.encode_status(status))
        writer.add_message("/robot_description", transport.text_message("<robot/>"))
        with pytest.raises(RecordingError, match="'grid_map' does not take nav_msgs/msg/OccupancyGrid"):
            writer.add_message("grid_map", grid)
    with open_recording(tmp_path / "a.mcap") as recording:
        assert [message.info.width for message in recording.messages("occupancy")] == [3]
        assert [found.step for found in recording.stance_pauses()] == [2]
        assert [found.status[0].name for found in recording.messages("status")] == ["scanner"]
        assert [found.data for found in recording.messages("/robot_description")] == ["<robot/>"]
        assert recording.scans == () and recording.calibration is None
        with pytest.raises(RecordingError, match="topic 'x' is unknown"):
            next(recording.messages("x"))
        with pytest.raises(RecordingError, match="extent is 'x'"):
            next(recording.terrains("x"))
        with pytest.raises(RecordingError, match="holds no frame"):
            recording.frame(FrameReference("/guara/camera/on", 1))


def test_log_time_is_the_order_of_writing(tmp_path: Path, peer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Times of writing, never going back though the clock does; frames keep their stamps, and are found by them."""
    from mcap.reader import make_reader

    clock = iter([50, 60, 40, *range(70, 200)])
    monkeypatch.setattr("transport.recording.writer.time.time_ns", lambda: next(clock))
    pictures = _write(tmp_path / "a.mcap", peer)
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

    _write(tmp_path / "a.mcap", peer)
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

    pictures = _write(tmp_path / "new.mcap", peer)
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


def test_what_was_acknowledged_survives_a_kill(tmp_path: Path, start) -> None:
    """After kill -9 in the middle of writing, every scan and grid that was acknowledged is recovered."""
    for round_number in range(3):
        path, mended = tmp_path / f"{round_number}.mcap", tmp_path / f"{round_number}-mended.mcap"
        process = start("record", str(path))
        process.expect(f"acknowledged {3 + 4 * round_number}")
        process.kill()
        process.wait()
        acknowledged = int(process.lines[-1].split()[1]) if process.lines[-1].count(" ") else -1
        with pytest.raises(RecordingError, match="guara recover"):
            open_recording(path)
        recovery = recover_recording(path, mended)
        assert not recovery.was_whole
        with open_recording(mended) as recording:
            whole = [scan.step for scan in recording.scans if scan.is_whole]
            assert whole[: acknowledged + 1] == list(range(acknowledged + 1)) and acknowledged >= 3
            assert recording.calibration == CALIBRATION
            sequences = [terrain.sequence for terrain in recording.terrains()]
            assert sequences[: acknowledged + 1] == list(range(1, acknowledged + 2))
            last = recording.scans[acknowledged].stripes[3]
            assert recording.frame(last.on).pixels[0, 0] == 3


@pytest.mark.slow
def test_a_cut_file_is_mended_wherever_it_was_cut(tmp_path: Path, peer) -> None:
    """Any cut gives either what came before it, or an error that says the file is none; the more, the more."""
    _write(tmp_path / "a.mcap", peer, scans=3)
    data = (tmp_path / "a.mcap").read_bytes()
    counts = []
    for number, length in enumerate(np.linspace(0, len(data) - 1, 40).astype(int)):
        cut, mended = tmp_path / f"{number}.cut", tmp_path / f"{number}.mcap"
        cut.write_bytes(data[:length])
        try:
            counts.append(recover_recording(cut, mended).messages)
        except RecordingError as error:
            assert "is no MCAP file" in str(error) and length < 100
            assert not mended.exists()
            continue
        with open_recording(mended) as recording:
            assert all(scan.is_whole for scan in recording.scans[:-1])
            for scan in recording.scans:
                for stripe in scan.stripes:
                    assert stripe.on is None or recording.frame(stripe.on).pixels.shape == (48, 64, 3)
    assert counts == sorted(counts) and counts[0] == 0 and counts[-1] == 3 * 14


def test_a_damaged_piece_is_left_out_and_reported(tmp_path: Path, peer) -> None:
    """Flipped bytes inside a chunk cost that chunk, not the file, and reading the file itself says so."""
    _write(tmp_path / "a.mcap", peer, scans=3)
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "b.mcap").write_bytes(bytes(data))
    recovery = recover_recording(tmp_path / "b.mcap", tmp_path / "c.mcap")
    assert recovery.damaged_chunks == 1 and not recovery.was_whole and 0 < recovery.messages < 42
    with open_recording(tmp_path / "c.mcap") as recording:
        assert recording.scans
    with pytest.raises(RecordingError, match="guara recover"):
        with open_recording(tmp_path / "b.mcap") as recording:
            for scan in recording.scans:
                for stripe in scan.stripes:
                    if stripe.on is not None:
                        recording.frame(stripe.on)
            list(recording.terrains())


def test_a_whole_file_is_copied_whole(tmp_path: Path, peer) -> None:
    """Recovery of a file that needs none loses nothing and says so."""
    _write(tmp_path / "a.mcap", peer)
    recovery = recover_recording(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert recovery.was_whole and recovery.bytes_lost == 0 and recovery.messages == 28
    with open_recording(tmp_path / "b.mcap") as recording:
        assert [scan.is_whole for scan in recording.scans] == [True, True]


def test_an_atomic_file_appears_whole_or_not_at_all(tmp_path: Path, peer) -> None:
    """Beside the name while it is written, and gone after an error."""
    _write(tmp_path / "a.mcap", peer, atomic=True)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    with pytest.raises(ZeroDivisionError):
        with RecordingWriter(tmp_path / "b.mcap", atomic=True) as writer:
            writer.begin_scan(_scan(peer))
            assert not (tmp_path / "b.mcap").exists()
            raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_misuse_is_refused_in_words(tmp_path: Path, peer) -> None:
    """Wrong order, existing or missing files, folders and closed recordings each have their message."""
    path = tmp_path / "a.mcap"
    writer = RecordingWriter(path)
    with pytest.raises(RecordingError, match="no scan is open"):
        writer.add_stripe(0, 0.0, None)
    with pytest.raises(RecordingError, match="no scan is open"):
        writer.end_scan()
    writer.begin_scan(_scan(peer))
    with pytest.raises(RecordingError, match="scan of step 3 is still open"):
        writer.begin_scan(_scan(peer))
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
    with pytest.raises(RecordingError, match="is no MCAP file"):
        recover_recording(tmp_path / "text.mcap", tmp_path / "b.mcap")
    with open_recording(path) as recording:
        assert [scan.is_whole for scan in recording.scans] == [False]


@pytest.mark.parametrize(
    ("fields", "words"),
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
def test_a_wrong_frame_is_refused(fields: dict, words: str) -> None:
    """Only pictures that can be read back are taken."""
    with pytest.raises(MessageError, match=words):
        FrameRecord(**fields)
