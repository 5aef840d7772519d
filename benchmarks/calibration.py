"""Prints how far a calibration from pictures is from the truth of a data folder."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

import guara_perception as gp
from guara_perception.app.calibrate import calibrate_folder
from kinematics import load_robot
from testbed.calibration_errors import BEYOND_MM, IN_RANGE_MM, height_errors, worst_rms
from testbed.grid_truth import figures, load_truth
from testbed.truth import truth_calibration


def report(data: Path, scans: list[str]) -> None:
    """Calibrate one data folder, compare with its true calibration and print every figure.

    Args:
        data: folder with calibration/ and scans/.
        scans: names of the scans to process; empty: all that have a truth.
    """
    robot = load_robot("guara")
    truth = truth_calibration(data)
    start = time.perf_counter()
    result = calibrate_folder(data / "calibration", force=True)
    seconds = time.perf_counter() - start
    estimate = result.calibration
    focal = [100 * (estimate.camera.matrix[i, i] / truth.camera.matrix[i, i] - 1) for i in (0, 1)]
    centre = estimate.camera.matrix[:2, 2] - truth.camera.matrix[:2, 2]
    change = np.linalg.inv(truth.transform_camera_to_base) @ estimate.transform_camera_to_base
    turn = np.rad2deg(np.linalg.norm(cv2.Rodrigues(change[:3, :3])[0]))
    shift = 1e3 * np.linalg.norm(estimate.transform_camera_to_base[:3, 3] - truth.transform_camera_to_base[:3, 3])
    pose = robot.stance_pose(result.session.stance).transform_base_to_footprint
    stages = ", ".join(f"{stage} {spent:.1f}" for stage, spent in result.seconds.items())
    print(f"{data.name}: verdict {estimate.quality['verdict']}, processing {seconds:.1f} s ({stages})")
    for reason in estimate.quality["reasons"]:
        print(f"  - {reason}")
    print(f"  focal lengths {focal[0]:+.3f} {focal[1]:+.3f} %, principal point {centre[0]:+.2f} {centre[1]:+.2f} px")
    print(f"  camera {shift:.3f} mm, {turn:.4f} degrees")
    for name, heights in (("-20 ...  80 mm", IN_RANGE_MM), ("80 ... 120 mm", BEYOND_MM)):
        errors = height_errors(truth, estimate, pose, heights)
        rms, index = worst_rms(errors)
        overall = 1e3 * np.sqrt(np.mean(np.concatenate(list(errors.values())) ** 2))
        print(f"  height error at {name}: worst stripe {rms:.3f} mm rms (index {index}), all {overall:.3f}")
    for path in sorted(data.glob("scans/*/truth.npz")):
        name = path.parent.name
        if scans and name not in scans:
            continue
        reference = load_truth(path, 5)
        rows = []
        for calibration in (estimate, truth):
            terrain = gp.process_scan(gp.open_scan(path.parent), calibration, robot, pictures=False)
            sigma = np.sqrt(terrain.layer("variance").astype(np.float64))
            used = reference.interior & np.isfinite(terrain.elevation)
            ratio = ((terrain.elevation - reference.mean) / sigma)[used]
            rows.append((figures(terrain, reference).mean, float(np.std(ratio)), float(np.mean(ratio))))
        print(
            f"  scan {name:<7} error {rows[0][0]:.4f} mm, with the true calibration {rows[1][0]:.4f}: ratio "
            f"{rows[0][0] / rows[1][0]:.2f}; error / sigma: std {rows[0][1]:.2f} mean {rows[0][2]:+.2f} "
            f"(true calibration {rows[1][1]:.2f} {rows[1][2]:+.2f})"
        )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="+", help="data folders with calibration/ and scans/")
    parser.add_argument("--scans", default="", help="comma-separated names of scans; default: all")
    arguments = parser.parse_args()
    for data in arguments.data:
        report(data, [name for name in arguments.scans.split(",") if name])


if __name__ == "__main__":
    main()
