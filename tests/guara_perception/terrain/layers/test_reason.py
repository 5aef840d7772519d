"""The text of a failed test: millimetres, degrees, and what has no value at all."""

from __future__ import annotations

import pytest

from guara_perception.terrain.layers.reason import Reason


@pytest.mark.parametrize(
    ("reason", "expected_text"),
    [
        (Reason("step", 0.0125, 0.01, "m"), "step 12.5 mm, allowed 10 mm"),
        (Reason("slope", 0.6, 0.54, "rad", "to the left"), "slope 34.4 deg, allowed 30.9 deg (to the left)"),
        (Reason("reach", float("nan"), 0.0, "rad", "of lf beyond"), "reach impossible (of lf beyond)"),
        (Reason("reach", float("nan"), 0.0, "rad"), "reach impossible"),
    ],
)
def test_text(reason: Reason, expected_text: str):
    """A value that does not exist is not printed as nan."""
    assert str(reason) == expected_text
