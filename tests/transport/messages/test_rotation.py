"""Tests of quaternions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.thorough import examples
from transport import MessageError
from transport.messages.quaternions import matrix_from_quaternion, quaternion_from_matrix

COMPONENT = st.floats(-1.0, 1.0)


@pytest.mark.slow
@given(st.tuples(COMPONENT, COMPONENT, COMPONENT, COMPONENT).filter(lambda q: np.linalg.norm(q) > 1e-3))
@settings(max_examples=examples(200), derandomize=True, deadline=None)
def test_quaternion_and_matrix_round_trip(components: tuple[float, float, float, float]) -> None:
    """A rotation survives the way into a quaternion and back."""
    q = np.array(components) / np.linalg.norm(components)
    rotation = matrix_from_quaternion(tuple(q))
    back = np.array(quaternion_from_matrix(rotation))
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(matrix_from_quaternion(tuple(back)), rotation, atol=1e-12)
    assert back[3] >= 0.0


def test_quaternion_turns_the_right_way() -> None:
    """A quarter turn about z takes x to y, and its quaternion is (0, 0, sin 45, cos 45 degrees)."""
    half = np.sqrt(0.5)
    rotation = matrix_from_quaternion((0.0, 0.0, half, half))
    np.testing.assert_allclose(rotation @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(quaternion_from_matrix(rotation), [0, 0, half, half], atol=1e-15)


@pytest.mark.parametrize("bad", [(0, 0, 0, 0), (0, 0, 0, 2), (np.nan, 0, 0, 1), (np.inf, 0, 0, 1)])
def test_a_quaternion_of_another_length_is_refused(bad: tuple[float, float, float, float]) -> None:
    """Only unit quaternions stand for rotations."""
    with pytest.raises(MessageError, match="unit quaternion"):
        matrix_from_quaternion(bad)
