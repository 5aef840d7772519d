"""Assignment of frames to triggers: the true offset of the clocks is found, or none, whatever went wrong."""

from __future__ import annotations

import random
from collections.abc import Mapping
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.arrays import Float
from drivers.sweep.sweep_proof import WAIT_UNIT, ClockMatch, uneven_waits
from tests.thorough import further

TOLERANCE = 0.001
OFFSET, DELAY, EXPOSURE, ARRIVAL = 77.0, 50e-6, 0.004, 0.0055
# Fault of an exposure: "missed", "doubled", or its delay [s].
Fault = str | float
# Number of stripes, trigger period [s], and True if an off frame comes first: with the firmware's ramp and 4 ms of
# light, with 0.5 ms of light and no off frame, and a coarse sweep.
SWEEPS = [(70, 0.0093, True), (70, 0.0059, False), (35, 0.0115, True)]


def triggers_of(stripes: int, gap: float, has_off: bool, tolerance: float = TOLERANCE) -> Float:
    """Times of the triggers of a sweep."""
    waits = uneven_waits(stripes, tolerance)
    gaps = [EXPOSURE + 0.0002] * has_off + [gap + WAIT_UNIT * wait for wait in waits[1:]]
    return np.cumsum([0.0, *gaps])


def stamps_of(triggers: Float, faults: Mapping[int, Fault]) -> Float:
    """Stamps of the camera's exposures; a trigger while the shutter is open is missed."""
    found, closed = [], -1.0
    for number, trigger in enumerate(triggers):
        fault = faults.get(number)
        if fault == "missed" or trigger < closed:
            continue
        start = trigger + DELAY + (fault if isinstance(fault, float) else 0.0)
        found.append(start)
        if fault == "doubled":
            found.append(start + EXPOSURE + DELAY)
        closed = found[-1] + EXPOSURE
    return np.array(found) + OFFSET


def proved_at(triggers: Float, stamps: Float) -> int | None:
    """Number of triggers, as the scan thread reads them, after which a true offset is proved; None if it never is."""
    match = ClockMatch(TOLERANCE)
    arrivals = stamps - OFFSET + ARRIVAL
    # A trigger is reported at the next trigger.
    for count, now in enumerate([*triggers[1:], triggers[-1] + 0.1], 1):
        match.learn(triggers[:count], stamps[arrivals <= now])
        if match.proved:
            centre = float(triggers[count // 2])
            assert match.frame_of(centre, np.array([centre + OFFSET + DELAY])) == 0
            return count
    return None


@pytest.mark.slow
@pytest.mark.parametrize("sweep", [SWEEPS[0], *further(*SWEEPS[1:])])
def test_any_two_triggers_may_go_wrong(sweep: tuple[int, float, bool]) -> None:
    """Any one or two triggers may be missed, doubled or late: the proved offset is the true one.

    Delays are short, as long as a wait, an interval, or both together, and long. Faults after the proof cannot change
    it, so pairs are tried only up to the proof.
    """
    triggers, gap = triggers_of(*sweep), sweep[1]
    kinds: list[Fault] = ["missed", "doubled", 0.0011, 0.002, gap, gap + 0.002, 0.02]
    tried = 0
    for first in range(triggers.size):
        for kind in kinds:
            proved = proved_at(triggers, stamps_of(triggers, {first: kind}))
            assert proved is not None
            for second in range(first + 1, min(proved + 1, triggers.size)):
                for other in kinds:
                    assert proved_at(triggers, stamps_of(triggers, {first: kind, second: other})) is not None
                    tried += 1
    assert tried > 500


@given(
    stripes=st.integers(35, 140),
    gap=st.floats(0.004, 0.06),
    tolerance=st.sampled_from([0.0001, 0.0005, 0.001, 0.0015, 0.002]),
)
@settings(deadline=None)
def test_every_shift_misses_frames(stripes: int, gap: float, tolerance: float) -> None:
    """Each shift by whole triggers leaves at least ten frames unexplained, for any errors within the tolerance."""
    triggers = triggers_of(stripes, gap, has_off=False, tolerance=tolerance)
    for shift in range(1, triggers.size):
        spans = np.sort(triggers[shift:] - triggers[:-shift])
        # Each frame may be off by the tolerance, so two that are not distinguished may be twice as far apart.
        alike = np.searchsorted(spans, spans + 2 * tolerance * (1 - 1e-6)) - np.arange(spans.size)
        assert alike.max() <= triggers.size - 10


@pytest.mark.parametrize("tolerance", [0.0001, 0.0007, 0.001, 0.002])
def test_waits_are_twice_the_tolerance(tolerance: float) -> None:
    """In whole units of the board, at uneven distances."""
    waits = uneven_waits(70, tolerance)
    lengths = {wait for wait in waits if wait}
    assert len(lengths) == 1 and 2 * tolerance <= lengths.pop() * WAIT_UNIT + 1e-9 < 2 * tolerance + WAIT_UNIT
    waiting = [index for index, wait in enumerate(waits) if wait]
    assert len(waiting) == 9 and len({after - here for here, after in pairwise(waiting)}) > 4


def test_a_camera_may_sleep_through_the_first_frames() -> None:
    """Almost a third of a standard sweep, two fifths of a coarse one."""
    for sweep, asleep in zip(SWEEPS, (20, 20, 14), strict=True):
        triggers = triggers_of(*sweep)
        assert proved_at(triggers, stamps_of(triggers, dict.fromkeys(range(asleep), "missed"))) is not None


def test_a_shift_is_never_taken_for_the_truth() -> None:
    """Random sweeps with missing, extra and late frames: the offset is the true one, or none."""
    rng = random.Random(3)
    triggers = triggers_of(70, 0.008, has_off=True)
    proved = 0
    for _ in range(300):
        share = rng.choice([0.02, 0.1, 0.3])
        stamps = [time for time in triggers if rng.random() > share]
        stamps += [rng.choice(triggers) + rng.uniform(0.001, 0.02) for _ in range(rng.randrange(6))]
        seen = np.sort(np.array(stamps)) + OFFSET
        match = ClockMatch(TOLERANCE)
        for count in range(1, 72):
            match.learn(triggers[:count], seen[seen <= triggers[count - 1] + OFFSET + EXPOSURE])
        if match.proved:
            proved += 1
            assert match.frame_of(triggers[35], np.array([triggers[35] + OFFSET])) == 0
            assert match.frame_of(triggers[36], np.array([triggers[35] + OFFSET])) is None
    assert proved > 250


def test_even_gaps_prove_nothing() -> None:
    """Without waits, a missed first trigger looks like a missed last one, so no offset is proved."""
    triggers = 0.008 * np.arange(71)
    match = ClockMatch(TOLERANCE)
    match.learn(triggers, triggers[1:] + 5.0)
    assert not match.proved
