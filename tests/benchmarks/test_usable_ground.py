"""Usable ground of rendered scans: nothing under a sole is dangerous."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_rendered_scans_beside_the_oracle(root: Path, data: Path) -> None:
    """Cells free in the grid but not in truth are one row off, beside a hazard at the rim of a sole's window."""
    command = [sys.executable, "-m", "benchmarks", "usable_ground", "--rendered", str(data)]
    run = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stderr
    counts = json.loads(run.stdout.splitlines()[-1])
    assert counts["free"] > 500 and counts["free and safe"] > 0.97 * counts["free"]
    for name in (
        "beyond oracle, more than one row off",
        "beyond oracle, relief over 1 mm",
        "free, unsafe by truth: relief",
        "free, unsafe by truth: dark",
        "unknown and free",
    ):
        assert counts[name] == 0, name
    assert counts["beyond oracle, hazard at the rim of the sole's window"] == counts["beyond oracle"]
