"""Compares the methods on recorded scans: error in mm and in the paper's own way, coverage, false returns, time."""

from __future__ import annotations

import argparse
import time

import numpy as np

import guara_perception as gp
from benchmarks.accuracy import add_data, scans_with_truth
from guara_perception.ranging.scan_geometry import in_groups
from guara_perception.stripe_finder import METHODS
from kinematics import load_robot
from testbed.grid_truth import Figures, figures

# The paper refers its error to the width of the surface.
SURFACE_MM = 540.0
HEADER = (
    "| scan | method | near mm | far mm | near % | far % | bias mm | worst mm | "
    "known % | false % | wrong | unsafe | ms |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|---|"
)


def row(name: str, method: str, f: Figures, milliseconds: float) -> str:
    """One line of the table (Markdown).

    Near and far are mean errors of the lowest and highest third in x; per cent are their 95 % bounds (2 sigma, from
    the mean error of a normal distribution) of the surface's width, as the paper states its error. False: cells that
    nobody could see and that are known all the same; wrong: those more than 2 mm outside their true heights.
    """
    two_sigma = 2 * np.sqrt(np.pi / 2)
    return (
        f"| {name} | {method} | {f.near:.3f} | {f.far:.3f} | {100 * two_sigma * f.near / SURFACE_MM:.3f} | "
        f"{100 * two_sigma * f.far / SURFACE_MM:.3f} | {f.bias:+.3f} | {f.worst:.1f} | {f.known:.2f} | "
        f"{f.unseen_known:.2f} | {f.unseen_wrong} | {f.unsafe} | {milliseconds:.0f} |"
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_data(parser)
    parser.add_argument("--method", default=",".join(METHODS), help="comma-separated methods")
    arguments = parser.parse_args()
    robot = load_robot("guara")
    print("the paper states 0.5 % near and 2.5 % far: 2.7 and 13.5 mm of 540 mm; ms without decoding the frames\n")
    print(HEADER)
    for name, scan, truth, calibration in scans_with_truth(arguments):
        frames = [gp.FramePair(stripe.index, on, off) for stripe, on, off in scan.frames()]
        for method in arguments.method.split(","):
            processor = gp.ScanProcessor(calibration, robot, scan.stance, scan.mode, method=method)
            start = time.process_time()
            for group in in_groups(frames):
                processor.add_all(group)
            terrain = processor.finish()
            seconds = time.process_time() - start
            print(row(name, method, figures(terrain, truth), 1e3 * seconds), flush=True)


if __name__ == "__main__":
    main()
