"""Errors of every scan of a data folder that has a truth, as the data's README defines them.

`python -m benchmarks accuracy DATA ... [--paper | --images]`; with --paper a table as README.md has it: per cent of the
surface's width, as the paper states its error, and processor time without decoding the frames; with --images the range
images (`benchmarks.range_images`).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import guara_perception as gp
from benchmarks.range_images import print_images
from guara_perception.ranging.scan_geometry import in_groups
from guara_perception.scanning.stripe_finder import METHODS
from kinematics import load_robot
from testbed.grid_truth import Figures, Truth, figures, load_truth
from testbed.truth import truth_calibration

# The paper refers its error to the width of the surface.
SURFACE_MM = 540.0
PAPER_HEADER = (
    "| scan | method | near mm | far mm | near % | far % | bias mm | worst mm | "
    "known % | false % | wrong | unsafe | ms |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|---|"
)
HEADER = (
    f"{'scan':<21} {'method':<7} {'mean':>6} {'p95':>5} {'worst':>5} | {'near':>5} {'far':>5} | "
    f"{'bias':>6} {'near':>6} {'far':>6} | {'known%':>6} {'unseen%':>8} {'wrong':>5} {'dark%':>6} {'unsafe':>6} | time"
)


def row(name: str, method: str, f: Figures, seconds: float) -> str:
    """One line of the table."""
    return (
        f"{name:<21} {method:<7} {f.mean:6.3f} {f.p95:5.2f} {f.worst:5.2f} | {f.near:5.3f} {f.far:5.3f} | "
        f"{f.bias:+.3f} {f.bias_near:+.3f} {f.bias_far:+.3f} | {f.known:6.2f} {f.unseen_known:8.2f} "
        f"{f.unseen_wrong:5d} {f.dark_known:6.2f} {f.unsafe:6d} | {seconds:.1f} s"
    )


def paper_row(name: str, method: str, f: Figures, seconds: float) -> str:
    """One line of the table (Markdown).

    Near and far are mean errors of the lowest and highest third in x; per cent are their 95 % bounds (2 sigma, from
    the mean error of a normal distribution) of the surface's width, as the paper states its error. False: cells that
    nobody could see and that are known all the same; wrong: those more than 2 mm outside their true heights.
    """
    two_sigma = 2 * np.sqrt(np.pi / 2)
    return (
        f"| {name} | {method} | {f.near:.3f} | {f.far:.3f} | {100 * two_sigma * f.near / SURFACE_MM:.3f} | "
        f"{100 * two_sigma * f.far / SURFACE_MM:.3f} | {f.bias:+.3f} | {f.worst:.1f} | {f.known:.2f} | "
        f"{f.unseen_known:.2f} | {f.unseen_wrong} | {f.unsafe} | {1e3 * seconds:.0f} |"
    )


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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="+", help="data folders with calibration/ and scans/")
    parser.add_argument("-c", "--calibration", type=Path, help="calibration.json; default: the truth of each folder")
    parser.add_argument("--scans", default="", help="comma-separated names of scans; default: all")
    parser.add_argument("--method", help="comma-separated methods; default: precise, with --paper all")
    terms = parser.add_mutually_exclusive_group()
    terms.add_argument("--paper", action="store_true", help="in the paper's terms, as a table in Markdown")
    terms.add_argument("--images", action="store_true", help="orthorectified range images, as a table in Markdown")
    arguments = parser.parse_args()
    robot = load_robot("guara")
    if arguments.images:
        scans = scans_with_truth(arguments.data, arguments.scans, arguments.calibration)
        print_images([(name, Path(scan.source).parent, calibration) for name, scan, _, calibration in scans], robot)
        return
    methods = arguments.method.split(",") if arguments.method else list(METHODS) if arguments.paper else ["precise"]
    if arguments.paper:
        print("the paper states 0.5 % near and 2.5 % far: 2.7 and 13.5 mm of 540 mm; ms without decoding the frames\n")
    else:
        print("millimetres; interior cells of 5 mm against the mean truth of the cell")
    print(PAPER_HEADER if arguments.paper else HEADER)
    for name, scan, truth, calibration in scans_with_truth(arguments.data, arguments.scans, arguments.calibration):
        frames = [gp.FramePair(stripe.index, on, off) for stripe, on, off in scan.frames()]
        for method in methods:
            processor = gp.ScanProcessor(calibration, robot, scan.stance, scan.mode, method=method)
            start = time.process_time()
            for group in in_groups(frames):
                processor.add_all(group)
            terrain = processor.finish()
            seconds = time.process_time() - start
            print_row = paper_row if arguments.paper else row
            print(print_row(name, method, figures(terrain, truth), seconds), flush=True)


if __name__ == "__main__":
    main()
