"""The benchmark of still pauses, with few of them."""

import pytest

from benchmarks.stillness import CASES, row


@pytest.mark.slow
def test_still_pauses_are_kept_and_motions_are_found() -> None:
    """Noise withdraws hardly any still pause, and motions that must be found are found."""
    _, _, moved, _, undetectable = row("guara", "12 bits, 0.05", CASES.index((False, "none", (0.0, 0.0))), 100)
    assert moved <= 0.02 and "send HOLD" in undetectable
    _, _, moved, _, _ = row("guara", "14 bits, 0", [case[:2] for case in CASES].index((False, "step")), 40)
    assert moved >= 0.9
