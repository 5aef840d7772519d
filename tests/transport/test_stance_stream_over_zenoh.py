"""Stream of joints between processes' sessions: batches in order, what is lost or unreadable told."""

import numpy as np
import pytest

import transport
from transport import keys
from transport.links.publisher import Publisher
from transport.recording.reader import open_recording
from transport.recording.writer import RecordingWriter

LEGS = ("lf", "rf")


def stance(angle: float, feet: tuple[str, ...] = LEGS, gravity: bool = False) -> transport.StanceMessage:
    return transport.StanceMessage(
        joint_positions={"a": angle, "b": -angle},
        support_feet=feet,
        gravity_in_base=(0.0, 0.0, -9.81) if gravity else None,
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
        with pytest.raises(transport.MessageError, match="support_feet names lh; allowed: lf, rf"):
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
    batch = transport.StanceStream(
        robot="guara",
        stamp=10**18,
        sequence=0,
        joint_names=("a",),
        legs=LEGS,
        times=[0.0, 0.01],
        joint_positions=[[0.1], [0.2]],
        supports=[[1, 1], [1, 1]],
    )
    with RecordingWriter(tmp_path / "s.mcap") as writer:
        writer.add_stance_stream(batch)
    with open_recording(tmp_path / "s.mcap") as recording:
        (found,) = recording.stance_stream()
    assert np.array_equal(found.joint_positions, batch.joint_positions) and found.stamp == batch.stamp
