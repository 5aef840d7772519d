"""Full disk: one line that names the user's file, exit code 1, and no partial file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.forked import run_forked
from tests.thorough import further

# A limit on the file size makes writes of a process fail like a full disk.
CODE = """
import json, resource, sys
from guara_perception.app.main import run
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
for arguments in json.loads(sys.argv[1]):
    print("=> exit", run(arguments), file=sys.stderr, flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [slice(1), *further(slice(1, None))])
def test_each_writing_command_names_its_file_and_leaves_none(
    data: Path, calibration_file: Path, terrain_file: Path, root: Path, tmp_path: Path, chosen: slice
) -> None:
    """Grid, pictures, calibration, export, scan folder, recording, targets, robot folder, keys."""
    scan, out = data / "scans" / "paper", tmp_path / "out"
    out.mkdir()
    urdf = root / "robots" / "guara" / "urdf" / "guara.urdf"
    commands = {
        "t.npz": ["process", scan, "-c", calibration_file, "-o", out / "t.npz"],
        "c.json": ["calibrate", data / "calibration", "-o", out / "c.json"],
        "t.csv": ["convert", terrain_file, out / "t.csv"],
        "t.ply": ["convert", terrain_file, out / "t.ply"],
        "scan.mcap": ["convert", scan, out / "scan.mcap"],
        "targets.pdf": ["targets", "-o", out / "targets.pdf"],
        "robot": ["robot", "new", urdf, "-o", out / "robot"],
        "keys": ["security", "init", out / "keys"],
        "recorded/on_": ["scan", out / "recorded", "--simulated"],
    }
    commands = dict(list(commands.items())[chosen])
    encoded = json.dumps([[str(word) for word in given] for given in commands.values()])
    done = run_forked("-c", CODE, encoded)
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stderr.splitlines() if not line.startswith("INFO")]
    assert lines[1::2] == ["=> exit 1"] * len(commands), done.stderr
    for name, line in zip(commands, lines[::2], strict=True):
        assert line.startswith("guara: ") and f"{out / name}" in line and "File too large" in line, line
    assert list(out.iterdir()) == []
