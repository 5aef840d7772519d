"""Height errors of a calibration: points seen by the true rangefinder, triangulated with the estimated calibration."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import guara_perception as gp
from guara_perception.arrays import Float
from guara_perception.calibration.calibration import plane_in_frame

IN_RANGE_MM = np.arange(-20, 81, 10)
BEYOND_MM = np.arange(80, 121, 10)
AREA_X, AREA_Y = (0.50, 0.95), (-0.27, 0.27)


def height_errors(
    truth: gp.Calibration,
    estimate: gp.Calibration,
    transform_base_to_footprint: Float,
    heights_mm: npt.NDArray[np.int64],
) -> dict[int, Float]:
    """Height errors of an estimated calibration [m], by stripe index.

    Points on the true laser planes, at the given ground heights, are projected with the true camera and triangulated
    with the estimate.
    """
    true_pose = transform_base_to_footprint @ truth.transform_camera_to_base
    camera_pose = transform_base_to_footprint @ estimate.transform_camera_to_base
    y = np.linspace(*AREA_Y, 201)
    width, height = truth.camera.size
    errors: dict[int, Float] = {}
    for stripe in truth.stripes:
        plane = plane_in_frame(stripe.plane, true_pose)
        plane_in_camera = estimate.stripe(stripe.index).plane
        found = []
        for ground_height in heights_mm * 1e-3:
            x = -(plane[1] * y + plane[2] * ground_height + plane[3]) / plane[0]
            points = np.column_stack((x, y, np.full(len(y), ground_height)))
            pixels = truth.camera.project((points - true_pose[:3, 3]) @ true_pose[:3, :3])
            visible = (pixels[:, 0] >= 0) & (pixels[:, 0] <= width - 1) & (pixels[:, 1] >= 0)
            visible &= (pixels[:, 1] <= height - 1) & (x > AREA_X[0]) & (x < AREA_X[1])
            rays = estimate.camera.rays(pixels[visible])
            points = rays * (-plane_in_camera[3] / (rays @ plane_in_camera[:3]))[:, None]
            found.append(points @ camera_pose[2, :3] + camera_pose[2, 3] - ground_height)
        errors[stripe.index] = np.concatenate(found)
    return errors


def worst_rms(errors: dict[int, Float]) -> tuple[float, int]:
    """Largest rms error of a stripe [mm], and index of this stripe."""
    rms = {index: 1e3 * float(np.sqrt(np.mean(e**2))) for index, e in errors.items() if e.size}
    index = max(rms, key=lambda i: rms[i])
    return rms[index], index
