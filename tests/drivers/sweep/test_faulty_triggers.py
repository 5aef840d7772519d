"""Missed, doubled and late triggers at random: each is detected, and no stripe is wrong."""

from __future__ import annotations

import pytest

from testbed.faulty_triggers import faults


@pytest.mark.slow
def test_no_wrong_stripe_and_every_fault_found() -> None:
    found = faults(12, seed=3)
    assert found["wrong_stripes"] == 0 and found["injected"] == found["found"] > 20
