"""Prints the errors of every scan of a data folder that has a truth, as the data's README defines them."""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path

import guara_perception as gp
from kinematics import load_robot
from testbed.grid_truth import Figures, Truth, figures, load_truth
from testbed.truth import truth_calibration

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


def add_data(parser: argparse.ArgumentParser) -> None:
    """Arguments that say which recorded scans take part."""
    parser.add_argument("data", type=Path, nargs="+", help="data folders with calibration/ and scans/")
    parser.add_argument("-c", "--calibration", type=Path, help="calibration.json; default: the truth of each folder")
    parser.add_argument("--scans", default="", help="comma-separated names of scans; default: all")


def scans_with_truth(arguments: argparse.Namespace) -> Iterator[tuple[str, gp.Scan, Truth, gp.Calibration]]:
    """Name, scan, truth on cells of 5 mm and calibration of every scan that the arguments of `add_data` ask for."""
    for data in arguments.data:
        calibration = gp.load_calibration(arguments.calibration) if arguments.calibration else truth_calibration(data)
        for path in sorted(data.glob("scans/*/truth.npz")):
            if not arguments.scans or path.parent.name in arguments.scans.split(","):
                yield f"{data.name}/{path.parent.name}", gp.open_scan(path.parent), load_truth(path, 5), calibration


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_data(parser)
    parser.add_argument("--method", default="precise", help="comma-separated methods")
    parser.add_argument("--no-gravity", action="store_true", help="leave gravity out of each stance")
    parser.add_argument("--no-off", action="store_true", help="leave out the frames with the laser off")
    arguments = parser.parse_args()
    robot = load_robot("guara")
    print("millimetres; interior cells of 5 mm against the mean truth of the cell")
    print(HEADER)
    for name, scan, truth, calibration in scans_with_truth(arguments):
        if arguments.no_gravity:
            scan = dataclasses.replace(scan, stance=dataclasses.replace(scan.stance, gravity_in_base=None))
        if arguments.no_off:
            stripes = tuple(dataclasses.replace(stripe, off=None) for stripe in scan.stripes)
            scan = dataclasses.replace(scan, stripes=stripes)
        for method in arguments.method.split(","):
            start = time.perf_counter()
            terrain = gp.process_scan(scan, calibration, robot, method=method, pictures=False)
            seconds = time.perf_counter() - start
            print(row(name, method, figures(terrain, truth), seconds), flush=True)


if __name__ == "__main__":
    main()
