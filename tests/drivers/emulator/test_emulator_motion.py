"""The emulated motor."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testbed.bench_board.mirror import LossyMotor
from tests.thorough import examples

SPEED, SETTLE, OVERSHOOT = 1000.0, 0.01, 32


def motor(position: float = 0.0) -> LossyMotor:
    return LossyMotor(SPEED, SETTLE, OVERSHOOT, position, 0.0)


@pytest.mark.slow
@given(st.lists(st.tuples(st.integers(0, 5000), st.floats(0.0, 3.0)), min_size=1, max_size=6))
@settings(max_examples=examples(100), derandomize=True)
def test_no_motion_is_faster_than_the_motor(moves: list[tuple[int, float]]) -> None:
    """Whatever is commanded at any time, the position never jumps."""
    device, now = motor(), 0.0
    for target, gap in moves:
        now += gap
        device.move(target, now)
    end = device.still_at + 0.1
    instants = [end * index / 3000 for index in range(3001)]
    positions = [device.true_position(instant) for instant in instants]
    fastest = max(abs(b - a) for a, b in zip(positions, positions[1:], strict=False)) / (end / 3000)
    assert fastest <= SPEED * (1 + 1e-6)
    assert positions[-1] == pytest.approx(moves[-1][0])


def test_a_move_up_goes_straight_and_settles() -> None:
    """Duration is distance over speed, plus the settling time."""
    device = motor()
    device.move(500, 1.0)
    assert device.true_position(1.25) == pytest.approx(250)
    assert device.still_at == pytest.approx(1.5 + SETTLE)


def test_a_move_down_comes_back_from_below() -> None:
    """To take up backlash, the last approach is always upwards."""
    device = motor(500)
    device.move(100, 0.0)
    assert device.true_position(0.4 + OVERSHOOT / SPEED) == pytest.approx(100 - OVERSHOOT)
    assert device.true_position(device.still_at) == pytest.approx(100)


def test_lost_steps_are_not_believed() -> None:
    """The firmware reports the target, but the mirror is off by the lost steps."""
    device = motor()
    device.lost -= 25
    device.move(500, 0.0)
    assert device.believed_position(10.0) == pytest.approx(500)
    assert device.true_position(10.0) == pytest.approx(475)


def test_halt_keeps_the_position() -> None:
    """A halted motor keeps its position."""
    device = motor()
    device.move(500, 0.0)
    device.halt(0.2)
    assert device.true_position(5.0) == pytest.approx(200)
