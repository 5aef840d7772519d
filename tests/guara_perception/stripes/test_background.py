"""The background of a sweep without laser-off frames."""

from __future__ import annotations

import numpy as np

from guara_perception.stripes.background import SweepBackground


def sweep_frame(number: int) -> np.ndarray:
    frame = np.full((120, 64), 40, np.uint8)
    frame[10 * number + 4 : 10 * number + 7] = 200
    return frame


def test_background_of_a_sweep_is_the_darker_of_two_earlier_frames() -> None:
    """From the seventh stripe on, two frames without this stripe serve, and no other stripe is left in the minimum."""
    sweep = SweepBackground(stride=2)
    for number in range(10):
        background = sweep.add(2 * number, sweep_frame(number), (0, 120))
        assert background.reason == ""
        if number < 6:
            assert background.off is None
        else:
            assert background.off is not None
            assert (background.off == 40).all()


def test_lost_frame_costs_the_stripes_that_it_would_have_served() -> None:
    """Which frames serve a stripe never changes: without one of them the stripe is given up, with the reason."""
    sweep = SweepBackground(stride=1)
    reasons = {number: sweep.add(number, sweep_frame(number), (0, 120)).reason for number in range(11) if number != 4}
    assert [number for number, reason in reasons.items() if reason] == [7, 10]
    assert reasons[7] == "no laser-off frame, and frame 4, which would serve instead, was lost"


def test_frames_out_of_order_estimate_their_own_background() -> None:
    """A stripe that comes late is served by its own frame."""
    sweep = SweepBackground(stride=1)
    sweep.add(9, sweep_frame(9), (0, 120))
    late = sweep.add(3, sweep_frame(3), (0, 120))
    assert (late.off, late.reason) == (None, "")
