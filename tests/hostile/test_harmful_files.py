"""Files made to harm their reader: each is refused, within its bounds of memory and time."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.hostile.harmful_files import FILES
from tests.hostile.reading_cost import MEMORY_MB, SECONDS

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def costs() -> dict[str, dict]:
    """Costs of all files by name, from one run of the program."""
    command = [sys.executable, "-m", "tests.hostile.reading_cost", "--json"]
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
