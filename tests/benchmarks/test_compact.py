"""What `python -m benchmarks.compact` prints of sizes; times are printed and not judged."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks import compact

pytestmark = pytest.mark.heavy


def test_a_compact_grid_is_an_eighth_of_the_lossless_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Recorded scans and a map with its ceiling: under 65 kB each; the table has a row for each grid and encoding."""
    monkeypatch.setattr(compact, "ROUNDS", 1)
    made: list[dict[str, Any]] = []
    measured = compact.measured
    monkeypatch.setattr(compact, "measured", lambda *grid: made.extend(rows := measured(*grid)) or rows)
    compact.main()
    assert len(capsys.readouterr().out.splitlines()) == 1 + len(made) == 9
    for row in made:
        if row["encoding"] == "compact":
            assert row["bytes"] < 65_000 and row["share"] < 0.15
        else:
            assert row["share"] == 1.0 and row["bytes"] > 350_000
        assert row["make_ms"] > 0.0 and row["read_ms"] > 0.0
