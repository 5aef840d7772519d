"""Usable ground of rendered scans: what is free beyond the oracle is explained, nothing under a sole is dangerous."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from benchmarks.beyond_oracle import beyond_oracle, explained


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


def test_a_cell_beyond_the_oracle_says_which_test_the_truth_fails() -> None:
    """A wall that the grid has one cell farther away than it is: the cells there, its height and the limit."""
    _, x = np.mgrid[:60, :80]
    measured, true = (
        gp.assess_terrain(np.where(x >= wall, 0.05, 0.0), 0.005, variance=np.full(x.shape, 1e-8)) for wall in (50, 49)
    )
    found = list(beyond_oracle(measured, true, np.eye(4)))
    assert len(found) == ((measured.hazard == 0) & (true.hazard != 0)).sum() > 0
    for each in found:
        assert each.at_rim
        step = next(test for test in each.exceeded if test[0] == "step")
        assert step[-1] == "mm" and np.allclose(step[1:-1], (50.0, 0.0, 30.0), atol=1e-3)
    lines = list(explained(found))
    assert sum(int(line.split()[0]) for line in lines) == len(found)
    assert all("step 50.0 mm by truth, 0.0 here, limit 30.0" in line for line in lines)
    assert not list(beyond_oracle(true, true, np.eye(4)))
