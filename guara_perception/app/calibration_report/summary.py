"""Summarises a calibration in a few lines for the terminal."""

from __future__ import annotations

import numpy as np

from guara_perception.calibration.quality import Check
from guara_perception.calibration.result import CalibrationResult

MARKS = {"good": "ok  ", "usable": "weak", "refused": "BAD "}


def summary(result: CalibrationResult) -> str:
    """Verdict, lens, mount, every check with its limits, and the reasons."""
    matrix, camera = result.fit.camera.matrix, result.fit.camera
    x, y, z = result.calibration.transform_camera_to_base[:3, 3]
    lines = [
        f"verdict: {result.verdict}",
        f"camera: {camera.size[0]}x{camera.size[1]} px, focal lengths {matrix[0, 0]:.2f} {matrix[1, 1]:.2f} px, "
        f"principal point {matrix[0, 2]:.2f} {matrix[1, 2]:.2f} px",
        f"mount: {MOUNTS[result.floor.mount]}, optical centre at {x:.4f} {y:.4f} {z:.4f} m in "
        f"base_link, {1e3 * result.fit.transform_camera_to_footprint[2, 3]:.1f} mm above the floor",
        f"laser: {len(result.calibration.stripes)} stripes, axis at {_axis(result)} in base_footprint",
        "checks (limit of good, limit of refused):",
    ]
    width = max(len(check.name) for check in result.checks)
    lines += [
        f"  {MARKS[check.verdict]} {check.name:<{width}}  {value_text(check):>13}  {limits_text(check)}"
        for check in result.checks
    ]
    if result.reasons:
        lines.append("because:")
        lines += [f"  - {reason}" for reason in result.reasons]
    return "\n".join(lines)


MOUNTS = {"eq5": "as eq. 5 of the paper (rows grow forward)", "upright": "upright (rows grow backward)"}


def value_text(check: Check) -> str:
    """The value of a check with its unit."""
    return "not found" if np.isnan(check.value) else f"{check.value:.3g} {check.unit}"


def limits_text(check: Check) -> str:
    """The limits of good and of refused, with the sign that says on which side of them values are good."""
    side = ">=" if check.higher_is_better else "<="
    return f"({side} {check.usable_from:g}, {side} {check.refused_from:g})"


def _axis(result: CalibrationResult) -> str:
    point = result.laser.sweep.mirror.point
    return f"x {point[0]:.4f} z {point[2]:.4f} m"
