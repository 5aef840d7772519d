"""Memory that a scan adds to a process."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.section import Section
from guara_perception.app.node.rangefinder import STRIPES_TOGETHER
from testbed.scenes import ROBOTS, ScanInMemory

ROOT = ROBOTS.parent


def memory(scan: ScanInMemory) -> Section:
    """Peak memory of a process that scans, above what it held before."""
    with tempfile.TemporaryDirectory() as folder:
        _write_bands(scan, Path(folder))
        first, second, frames = _growth(folder, scan, 1)
        node, _, _ = _growth(folder, scan, STRIPES_TOGETHER)
    figures = {"first_mb": first, "second_mb": second, "frame_pair_mb": frames, "node_mb": node}
    rows: list[tuple[str, ...]] = [
        ("one pair of frames, for comparison", f"{frames:.1f}"),
        ("a scan stripe by stripe, its frame pair included", f"{first:.1f}"),
        ("the next scan, above the peak of the first", f"{second:.1f}"),
        (f"a scan by {STRIPES_TOGETHER} stripes at once as in a node, their frames included", f"{node:.1f}"),
    ]
    return Section(
        "memory",
        f"Memory of a scan ({scan.name})",
        "Growth of the peak resident memory of a fresh process that has everything loaded and has scanned one stripe. "
        f"A node holds more than one frame: up to {STRIPES_TOGETHER} that it processes at once for a third less "
        "processor time, and one laser-off picture; the target is for what is scanned stripe by stripe.",
        ("what", "MB"),
        rows,
        figures,
    )


def _growth(folder: str, scan: ScanInMemory, together: int) -> tuple[float, float, float]:
    """Output of `memory_peer` in a process of its own [MB]."""
    code = f"from benchmarks.memory_peer import main; main({folder!r}, {len(scan.frames)}, {together})"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    first, second, frames = (float(word) for word in done.stdout.split())
    return first, second, frames


def _write_bands(scan: ScanInMemory, folder: Path) -> None:
    """Write what the measured process makes its frames from, one by one: one off frame and the bands of the stripes."""
    processor = scan.processor()
    np.save(folder / "off.npy", scan.frames[0][2])
    for index, on, _ in scan.frames:
        first, end = processor.band(index)
        (folder / f"{index}.band").write_bytes(on[first:end].tobytes())
    width, height = scan.calibration.camera.size
    (folder / "scan.txt").write_text(f"{width} {height} {len(scan.frames)}")
