"""Cost of a new process: imports, a first scan, and the memory that a scan adds."""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import guara_perception as gp
from benchmarks.rounds import alternate
from benchmarks.section import Effort, Section
from guara_perception.app.node.rangefinder import STRIPES_TOGETHER
from testbed.scenes import ROBOTS, ScanInMemory
from testbed.truth import truth_calibration

ROOT = ROBOTS.parent
LIBRARIES = "import numpy, cv2"
PACKAGE = "import guara_perception"
SCANNER = "from guara_perception import ScanProcessor, load_calibration"
COMMAND = "guara process, a first scan with its decoding"


def starting(data: Path, effort: Effort) -> Section:
    """CPU time of new processes, as a ratio to importing the libraries alone."""
    with tempfile.TemporaryDirectory() as folder:
        calibration = Path(folder) / "calibration.json"
        gp.save_calibration(truth_calibration(data), calibration)
        scan = str(data / "scans" / "dark")
        process = f"""
import sys
from guara_perception.app.main import main
sys.argv = ["guara", "process", {scan!r}, "-c", {str(calibration)!r}, "-o", {folder + "/grid.npz"!r}]
main()
"""
        runs: dict[str, Callable[[], None]] = {
            name: _python(code) for name, code in ((LIBRARIES, LIBRARIES), (PACKAGE, PACKAGE), (SCANNER, SCANNER))
        }
        runs[COMMAND] = _python(process)
        timings = alternate(runs, effort.starts, clock=_children)
        start = time.perf_counter()
        runs[COMMAND]()
        wall = time.perf_counter() - start
    rows: list[tuple[str, ...]] = []
    figures: dict[str, Any] = {}
    for name in runs:
        ratio = timings.ratio(name, LIBRARIES)
        figures[name] = {"ratio": ratio.median, "seconds_cpu": timings.milliseconds(name) / 1e3}
        rows.append((name, f"{timings.milliseconds(name) / 1e3:.2f}", str(ratio)))
    figures[COMMAND]["seconds_wall"] = wall
    rows.append((f"{COMMAND}, wall time", f"{wall:.2f}", ""))
    return Section(
        "starting",
        "Starting",
        "CPU time of a fresh Python process that does this and ends, files in the system's cache; ratio to importing "
        "numpy and cv2 alone.",
        ("process", "s CPU", "x numpy, cv2"),
        rows,
        figures,
    )


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


def _python(code: str) -> Callable[[], None]:
    def run() -> None:
        subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)

    return run


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
