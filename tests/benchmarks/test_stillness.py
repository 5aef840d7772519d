"""The benchmark of still pauses, with few of them."""

import pytest

from benchmarks.stillness import CASES, row


@pytest.mark.slow
def test_the_table_tells_what_single_readings_got_wrong() -> None:
    """Still pauses that single readings withdraw are kept, motions that must be found are found."""
    still = row("guara", "12 bits, 0.05", CASES.index((False, "none", (0.0, 0.0))), 100)
    assert still.before > 0.3 and still.now <= 0.02 and "send HOLD" in still.undetectable
    moved = row("guara", "14 bits, 0", [case[:2] for case in CASES].index((False, "step")), 40)
    assert moved.now >= 0.9
