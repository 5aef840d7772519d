"""The benchmark of announcements as a smoke test: every kind is sent, none floods the log; no time is asserted."""

import pytest

from benchmarks.announcements import FLOODS, HOLDS, measure

pytestmark = pytest.mark.heavy


def test_every_kind_of_message_is_sent_and_none_floods_the_log() -> None:
    """HOLD confirms the grid (the benchmark stops when it does not); a flood writes one line to the log at most."""
    costs = measure(0.3)
    assert set(costs) == {f"{kind} at {rate:g} Hz" for kind, rate in (*HOLDS, *FLOODS)}
    assert all(sent > 0 for sent, _, _ in costs.values())
    assert max(lines for _, _, lines in costs.values()) * 0.3 <= 1.0
