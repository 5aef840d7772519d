"""Stream of joints between processes' sessions: batches in order, what is lost or unreadable told."""

import numpy as np
import pytest

import transport
from transport import keys
from transport.links.publisher import Publisher
from transport.recording import FlashRecord, RecordingWriter, ScanRecord, open_recording

LEGS = ("lf", "rf")


def stance(angle: float, feet: tuple[str, ...] = LEGS, gravity: bool = False) -> transport.StanceMessage:
    return transport.StanceMessage(
        joint_positions={"a": angle, "b": -angle},
        support_feet=feet,
        gravity_in_base=(0.0, 0.0, -9.81) if gravity else None,
    )


def batch(sequence: int = 0) -> transport.StanceStream:
    return transport.StanceStream(
        robot="guara",
        stamp=10**18,
        sequence=sequence,
        joint_names=("a",),
        legs=LEGS,
        times=[0.0, 0.01],
        joint_positions=[[0.1], [0.2]],
        supports=[[1, 1], [1, 1]],
    )


@pytest.mark.slow
def test_every_sample_arrives_in_batches_in_order(endpoint: str, eventually) -> None:
    """At 1 kHz, a foot lifted and an IMU that comes late: a batch holds what is alike."""
    batches: list[transport.StanceStream] = []
    refused: list[str] = []
    with transport.open_node(listen=endpoint) as session, transport.open_client(endpoint, timeout=180.0) as other:
        transport.StanceStreamReceiver(
            session, on_batch=batches.append, on_refused=lambda error: refused.append(str(error))
        )
        publisher = transport.StanceStreamPublisher(other, LEGS, epoch="walk")
        for k in range(200):
            feet = LEGS if k < 50 else LEGS[:1]
            publisher.add(10**9 + k * 10**6, stance(1e-3 * k, feet, gravity=k >= 105), (0.0, 0.0, 0.1))
        with pytest.raises(transport.MessageError, match="stamp is 1000000000 ns; allowed: later than"):
            publisher.add(10**9, stance(0.0))
        with pytest.raises(transport.MessageError, match="support_feet contains lh; allowed: lf, rf"):
            publisher.add(10**10, stance(0.0, ("lh",)))
        publisher.flush(30.0)
        assert eventually(lambda: sum(len(batch.stamps) for batch in batches) == 200)
        Publisher(other, keys.stance_stream_key("guara"), latched=False).put(b"no joints")
        assert eventually(lambda: refused != [])
    stamps = np.concatenate([batch.stamps for batch in batches])
    assert (stamps == 10**9 + np.arange(200) * 10**6).all()
    joints = np.concatenate([batch.joint_positions for batch in batches])
    assert (joints[:, 0] == 1e-3 * np.arange(200)).all()
    supports = np.concatenate([batch.supports for batch in batches])
    assert supports[:, 0].all() and (supports[:, 1] == (np.arange(200) < 50)).all()
    assert [batch.sequence for batch in batches] == list(range(len(batches))) and len(batches) >= 10
    assert sum(len(batch.stamps) for batch in batches if batch.gravity_in_base is not None) == 95
    assert all(
        batch.epoch == "walk" and np.shape(batch.angular_velocity) == (len(batch.stamps), 3) for batch in batches
    )


@pytest.mark.slow
def test_a_recording_keeps_the_stream(tmp_path) -> None:
    given = batch()
    with RecordingWriter(tmp_path / "s.mcap") as writer:
        writer.add_stance_stream(given)
    with open_recording(tmp_path / "s.mcap") as recording:
        (found,) = recording.stance_stream()
    assert np.array_equal(found.joint_positions, given.joint_positions) and found.stamp == given.stamp


@pytest.mark.slow
def test_a_recording_keeps_the_instants_of_flashes(tmp_path) -> None:
    """To the nanosecond, of those stripes that had one; the stream is found by when it was written."""
    scan = ScanRecord(robot="guara", mode="coarse", stamp=10**18, step=3, stance=stance(0.1))
    flash = FlashRecord(10**18 + 5, 10**18 + 123_456_789, 2_000_001)
    with RecordingWriter(tmp_path / "s.mcap") as writer:
        writer.begin_scan(scan)
        for index in (0, 2):
            writer.add_stripe(index, 0.1, None, stamp=10**18)
        writer.add_flash(2, flash)
        writer.end_scan()
        with pytest.raises(transport.RecordingError, match="no scan is open"):
            writer.add_flash(2, flash)
        for sequence in range(3):
            writer.add_stance_stream(batch(sequence))
    with open_recording(tmp_path / "s.mcap") as recording:
        assert [stripe.flash for stripe in recording.scans[0].stripes] == [None, flash]
        written = [time for time, _ in recording.written("stance_stream")]
        for since, until, kept in ((0, None, 3), (written[1], None, 2), (written[0], written[1], 2), (0, 1, 0)):
            assert len(list(recording.stance_stream(since, until))) == kept
