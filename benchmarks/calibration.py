"""Calibrations: errors against the truth, drift, misplaced crosses, a moved mount.

`python -m benchmarks calibration PART ...`; without a part: a list of them.
"""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np

import guara_perception as gp
from benchmarks import drift_check, misplaced_crosses, mounting
from benchmarks.accuracy import scans_with_truth
from benchmarks.command import Table, options, run_part
from guara_perception.app.files.calibration_session import open_session
from guara_perception.calibration.calibrate_session import calibrate_session
from guara_perception.terrain.map.fuse_scan import pose_variance
from kinematics import load_robot
from testbed.calibration_errors import BEYOND_MM, IN_RANGE_MM, height_errors, worst_rms
from testbed.grid_truth import figures
from testbed.truth import truth_calibration


def report(data: Path, scans: str) -> None:
    """Calibrate one data folder, compare with its true calibration and print every figure.

    Args:
        data: folder with calibration/ and scans/.
        scans: comma-separated names of scans; empty: all that have a truth.
    """
    robot = load_robot("guara")
    true = truth_calibration(data)
    start = time.perf_counter()
    result = calibrate_session(open_session(data / "calibration"), robot)
    seconds = time.perf_counter() - start
    estimate = result.calibration
    focal = [100 * (estimate.camera.matrix[i, i] / true.camera.matrix[i, i] - 1) for i in (0, 1)]
    centre = estimate.camera.matrix[:2, 2] - true.camera.matrix[:2, 2]
    change = np.linalg.inv(true.transform_camera_to_base) @ estimate.transform_camera_to_base
    turn = np.rad2deg(np.linalg.norm(cv2.Rodrigues(change[:3, :3])[0]))
    shift = 1e3 * np.linalg.norm(estimate.transform_camera_to_base[:3, 3] - true.transform_camera_to_base[:3, 3])
    pose = robot.stance_pose(result.session.stance).transform_base_to_footprint
    print(f"{data.name}: verdict {estimate.quality['verdict']}, processing {seconds:.1f} s")
    for reason in estimate.quality["reasons"]:
        print(f"  - {reason}")
    print(f"  focal lengths {focal[0]:+.3f} {focal[1]:+.3f} %, principal point {centre[0]:+.2f} {centre[1]:+.2f} px")
    print(f"  camera {shift:.3f} mm, {turn:.4f} degrees")
    for name, heights in (("-20 ...  80 mm", IN_RANGE_MM), ("80 ... 120 mm", BEYOND_MM)):
        errors = height_errors(true, estimate, pose, heights)
        rms, index = worst_rms(errors)
        overall = 1e3 * np.sqrt(np.mean(np.concatenate(list(errors.values())) ** 2))
        print(f"  height error at {name}: worst stripe {rms:.3f} mm rms (index {index}), all {overall:.3f}")
    table = Table(
        "scan:<20 | error mm:.4f | true calibration's:.4f | ratio:.2f | error / sigma, std:.2f | mean:+.2f | "
        "true calibration's, std:.2f | mean:+.2f"
    )
    for name, scan, reference, _ in scans_with_truth([data], scans):
        rows = []
        for calibration in (estimate, true):
            terrain = gp.process_scan(scan, calibration, robot, pictures=False)
            # The stance of a recorded scan is exact.
            of_pose = pose_variance(terrain, *(each.ravel() for each in np.meshgrid(*terrain.geometry.centres())))
            sigma = np.sqrt(terrain.variance.astype(np.float64) - of_pose.reshape(terrain.shape))
            used = reference.interior & np.isfinite(terrain.elevation)
            ratio = ((terrain.elevation - reference.mean) / sigma)[used]
            rows.append((figures(terrain, reference).mean, np.std(ratio), np.mean(ratio)))
        (own, *normalised), (best, *of_best) = rows
        table.row(name, own, best, own / best, *normalised, *of_best)


def errors() -> None:
    """Errors of a calibration from pictures against the truth of DATA [--scans NAME,NAME]."""
    asked = options(
        errors.__doc__,
        DATA=(Path, "data folders with calibration/ and scans/", {"nargs": "+"}),
        scans=("", "comma-separated names of scans; default: all"),
    )
    for data in asked.data:
        report(data, asked.scans)


def truth() -> None:
    """Write the true calibration of rendered DATA to a file [--out FILE]."""
    asked = options(
        truth.__doc__,
        DATA=(Path, "a data folder with calibration/truth.json and scans/"),
        out=(Path, "calibration.json to write", {"required": True}),
    )
    written = gp.save_calibration(truth_calibration(asked.data), asked.out)
    print(f"{asked.out}: {len(written.stripes)} stripes, hash {written.hash}")


def main() -> None:
    """Command line."""
    parts = {"errors": errors, "drift": drift_check.main, "crosses": misplaced_crosses.main, "truth": truth}
    run_part("calibration", {**parts, "mount": mounting.main})


if __name__ == "__main__":
    main()
