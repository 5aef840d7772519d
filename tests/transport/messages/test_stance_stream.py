"""Batches of stances: what goes in comes out, and what is none is refused by name."""

from dataclasses import replace

import numpy as np
import pytest

from tests.transport.messages.samples import sample_stream
from transport import MessageError, decode_stance_stream, encode_stance_stream, gravity_of_orientation
from transport.messages.codec import decode, encode
from transport.messages.typestore import STANCE_STREAM


def test_a_batch_comes_back_as_it_was(peer) -> None:
    """Every field, with and without an IMU; arrays cannot be written."""
    whole = sample_stream(peer)
    for stream in (whole, replace(whole, gravity_in_base=None, angular_velocity=None)):
        found = decode_stance_stream(bytes(encode_stance_stream(stream)))
        for field in stream.__dataclass_fields__:
            ours, theirs = getattr(stream, field), getattr(found, field)
            assert np.array_equal(ours, theirs) and type(ours) is type(theirs), field
            assert not isinstance(theirs, np.ndarray) or not theirs.flags.writeable
    assert (np.diff(whole.stamps) == [5_000_000, 5_100_000]).all() and whole.stamps[0] == whole.stamp


def test_no_list_of_float64_is_ever_empty(peer) -> None:
    """Fast-CDR and rosbags pad differently after an empty one; what is not measured is NaN, and read as None."""
    message = decode(encode_stance_stream(replace(sample_stream(peer), gravity_in_base=None)), STANCE_STREAM)
    assert np.isnan(message.gravity_in_base).all() and message.gravity_in_base.size == 9
    for field in ("gravity_in_base", "angular_velocity"):
        setattr(message, field, np.full(9, np.nan))
    found = decode_stance_stream(bytes(encode(message)))
    assert found.gravity_in_base is None and found.angular_velocity is None
    for refused in (np.array([]), np.array([0.0, 0.0, -1.0] * 2 + [np.nan] * 3), np.full(6, np.nan)):
        message.gravity_in_base = refused
        with pytest.raises(MessageError, match="gravity_in_base"):
            decode_stance_stream(bytes(encode(message)))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"times": [0.0, 0.01, 0.01]}, "times must begin with 0 and ascend"),
        ({"times": [0.001, 0.002, 0.003]}, "times must begin with 0 and ascend"),
        ({"times": []}, "times has 0 entries; allowed: 1 to 1000"),
        ({"times": [0.0, 5.0, 11.0]}, r"times of StanceStream is 11; allowed: .*0 to 10 s"),
        ({"joint_positions": [[0.1, 0.2]]}, r"joint_positions has shape \(1, 2\)"),
        ({"joint_positions": [[0.1, np.nan]] * 3}, "joint_positions"),
        ({"joint_names": ("a", "a")}, "joint_names contains a name twice"),
        ({"supports": [[1, 2]] * 3}, "supports of StanceStream is 2"),
        ({"joint_names": (), "joint_positions": [[]] * 3}, "joint_names is empty; allowed: 1 to 256 joints"),
        ({"gravity_in_base": []}, "gravity_in_base has shape"),
        ({"angular_velocity": [[0, 0, 0], [np.nan] * 3, [0, 0, 0]]}, "angular_velocity"),
        ({"gravity_in_base": [[0, 0, -1], [0, 0, -1], [0, np.nan, -1]]}, "gravity_in_base"),
        ({"gravity_in_base": [[0, 0, 0]] * 3}, "length of gravity_in_base is 0"),
        ({"gravity_in_base": [[0, 0, -1], [0, 0, -1], [0, 0, -2e6]]}, r"length of gravity_in_base is 2e\+06; allowed"),
        ({"gravity_in_base": [[0, 0, -1]] * 2}, "gravity_in_base has shape"),
        ({"angular_velocity": [[0, 0, 1e4]] * 3}, "angular_velocity of StanceStream is 10000"),
    ],
)
def test_what_is_no_batch_is_refused(peer, given: dict[str, object], message: str) -> None:
    with pytest.raises(MessageError, match=message):
        replace(sample_stream(peer), **given)


def test_gravity_follows_from_the_orientation_of_an_imu() -> None:
    """Nose down by 30 degrees, gravity points ahead of the body's own down."""
    half = np.radians(15.0)
    assert gravity_of_orientation((0.0, 0.0, 0.0, 1.0)) == pytest.approx((0.0, 0.0, -1.0))
    assert gravity_of_orientation((0.0, np.sin(half), 0.0, np.cos(half))) == pytest.approx((0.5, 0.0, -np.sqrt(0.75)))
    with pytest.raises(MessageError, match="quaternion of orientation has length 0.5"):
        gravity_of_orientation((0.0, 0.0, 0.0, 0.5))
