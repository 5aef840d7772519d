"""History of the emulated laser."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.emulator.light import Laser
from tests.thorough import examples


@pytest.mark.slow
@given(
    st.lists(st.floats(0.01, 1.0), min_size=1, max_size=8),
    st.floats(-0.5, 5.0),
    st.floats(0.01, 5.0),
)
@settings(max_examples=examples(150), derandomize=True)
def test_fraction_is_the_mean_over_instants(gaps: list[float], start: float, length: float) -> None:
    """The fraction of an interval equals the mean over many instants in it."""
    laser, now = Laser(0.0), 0.0
    for turn, gap in enumerate(gaps):
        now += gap
        laser.switch(turn % 2 == 0, now)
    instants = [start + (index + 0.5) * length / 500 for index in range(500)]
    mean = sum(laser.fraction(instant, instant) for instant in instants) / 500
    assert laser.fraction(start, start + length) == pytest.approx(mean, abs=0.01)


def test_switching_to_the_same_state_is_no_change() -> None:
    """The log has the time at which the light changed, not that of the command."""
    laser = Laser(0.0)
    laser.switch(True, 1.0)
    laser.switch(True, 2.0)
    assert [event.time for event in laser.log] == [0.0, 1.0]


def test_the_fraction_of_an_instant_is_all_or_nothing() -> None:
    """An empty interval has the light at its instant; before the log the laser was off."""
    laser = Laser(0.0)
    laser.switch(True, 1.0)
    assert laser.fraction(1.5, 1.5) == 1.0 and laser.fraction(0.5, 0.5) == laser.fraction(-1.0, -1.0) == 0.0
