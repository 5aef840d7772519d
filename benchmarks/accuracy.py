"""Height errors of recorded scans against their ground truth, as defined in the README of the data.

`python -m benchmarks accuracy DATA ... [--paper | --images]`; with --paper a table as README.md has it: per cent of the
surface's width, as the paper states its error, and processor time without decoding the frames; with --images the range
images (`benchmarks.range_images`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from benchmarks.range_images import print_images
from guara_perception.ranging.scan_geometry import in_groups
from guara_perception.scanning.stripe_finder import METHODS
from kinematics import load_robot
from testbed.grid_truth import Figures, Truth, figures, load_truth
from testbed.truth import truth_calibration

# The paper refers its error to the width of the surface.
SURFACE_MM = 540.0
PAPER_COLUMNS = (
    "near mm:.3f | far mm:.3f | near %:.3f | far %:.3f | bias mm:+.3f | worst mm:.1f | "
    "known %:.2f | false %:.2f | wrong:d | unsafe:d"
)
COLUMNS = (
    "mean:6.3f | p95:5.2f | worst:5.2f | near:5.3f | far:5.3f | bias:+6.3f | bias near:+6.3f | bias far:+6.3f | "
    "known %:7.2f | unseen %:8.2f | wrong:5d | dark %:6.2f | unsafe:6d"
)


def row(f: Figures) -> tuple[float, ...]:
    """Figures of the table, by COLUMNS."""
    errors = (f.mean, f.p95, f.worst, f.near, f.far, f.bias, f.bias_near, f.bias_far)
    return *errors, f.known, f.unseen_known, f.unseen_wrong, f.dark_known, f.unsafe


def paper_row(f: Figures) -> tuple[float, ...]:
    """Figures of the table in the paper's terms, by PAPER_COLUMNS.

    Near and far are mean errors of the lowest and highest third in x; per cent are their 95 % bounds (2 sigma, from
    the mean error of a normal distribution) of the surface's width, as the paper states its error. False: known
    cells that camera or laser could not see; wrong: those more than 2 mm outside their true heights.
    """
    percent = 100 * 2 * np.sqrt(np.pi / 2) / SURFACE_MM
    errors = (f.near, f.far, percent * f.near, percent * f.far, f.bias, f.worst)
    return *errors, f.known, f.unseen_known, f.unseen_wrong, f.unsafe


def scans_with_truth(
    folders: list[Path], names: str = "", calibration_file: Path | None = None
) -> Iterator[tuple[str, gp.Scan, Truth, gp.Calibration]]:
    """Name, scan, truth on cells of 5 mm and calibration of scans.

    Args:
        folders: data folders with calibration/ and scans/.
        names: comma-separated names of scans; empty: all.
        calibration_file: calibration to use; None = the truth of each folder.
    """
    for data in folders:
        calibration = gp.load_calibration(calibration_file) if calibration_file else truth_calibration(data)
        for path in sorted(data.glob("scans/*/truth.npz")):
            if not names or path.parent.name in names.split(","):
                yield f"{data.name}/{path.parent.name}", gp.open_scan(path.parent), load_truth(path, 5), calibration


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        DATA=(Path, "data folders with calibration/ and scans/", {"nargs": "+"}),
        calibration=(Path, "calibration.json; default: the truth of each folder"),
        scans=("", "comma-separated names of scans; default: all"),
        method=(str, "comma-separated methods; default: precise, with --paper all"),
        paper=(False, "in the paper's terms, as a table in Markdown"),
        images=(False, "orthorectified range images, as a table in Markdown"),
    )
    robot = load_robot("guara")
    scans = scans_with_truth(asked.data, asked.scans, asked.calibration)
    if asked.images:
        print_images([(name, Path(scan.source).parent, calibration) for name, scan, _, calibration in scans], robot)
        return
    if asked.paper:
        print("the paper states 0.5 % near and 2.5 % far: 2.7 and 13.5 mm of 540 mm; ms without decoding the frames\n")
    else:
        print("millimetres; interior cells of 5 mm against the mean truth of the cell")
    columns, values_of = (PAPER_COLUMNS, paper_row) if asked.paper else (COLUMNS, row)
    table = Table(f"scan:<21 | method:<20 | {columns} | ms:5.0f", markdown=asked.paper)
    methods = asked.method.split(",") if asked.method else list(METHODS) if asked.paper else ["precise"]
    for name, scan, truth, calibration in scans:
        frames = [gp.FramePair(stripe.index, on, off) for stripe, on, off in scan.frames()]
        for method in methods:
            processor = gp.ScanProcessor(calibration, robot, scan.stance, scan.mode, method=method)
            start = time.process_time()
            for group in in_groups(frames):
                processor.add_all(group)
            terrain = processor.finish()
            seconds = time.process_time() - start
            table.row(name, method, *values_of(figures(terrain, truth)), 1e3 * seconds)


if __name__ == "__main__":
    main()
