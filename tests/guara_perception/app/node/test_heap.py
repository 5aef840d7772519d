"""Freed memory is returned to the system."""

from pathlib import Path

import pytest

from guara_perception.app.node import heap as module
from guara_perception.app.node.heap import Heap


def resident_mb() -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def test_freed_memory_is_given_back_once_a_period(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pieces below others that are still in use, which the C library would keep."""
    monkeypatch.setattr(module, "PERIOD_S", 3600.0)
    heap = Heap()
    pieces = [bytes(60_000) for _ in range(2000)]
    last = bytes(60_000)
    del pieces
    kept = resident_mb()
    heap.trim()
    assert resident_mb() > kept - 50.0
    monkeypatch.setattr(module, "PERIOD_S", 0.0)
    heap.trim()
    assert resident_mb() < kept - 50.0
    assert len(last) == 60_000
