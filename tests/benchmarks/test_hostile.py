"""Files made to harm, as the benchmark makes them: each is refused, within its bounds of memory and time."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.hostile import MEMORY_MB, SECONDS
from benchmarks.hostile_files import FILES

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def costs() -> dict[str, dict]:
    """What each file of the benchmark cost, all read by one run of it."""
    command = [sys.executable, "-m", "benchmarks.hostile", "--json"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=500, check=False)
    assert run.returncode == 0, run.stderr[-2000:]
    return {cost["name"]: cost for cost in map(json.loads, run.stdout.splitlines())}


@pytest.mark.heavy
@pytest.mark.parametrize("name", list(FILES))
def test_a_hostile_file_is_refused_within_bounds(costs: dict[str, dict], name: str) -> None:
    """No traceback, no crash, no gigabyte, no minute."""
    cost = costs[name]
    assert cost["outcome"].startswith(("refused: ", "read"))
    assert cost["memory"] <= MEMORY_MB * 1e6 and cost["seconds"] <= SECONDS, cost
