"""Camera frames for pictures: the frame of the median stripe, all stripes in one image, and either from above."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Float, Grey, Image, Interval
from guara_perception.calibration.calibration import CameraModel
from guara_perception.exceptions import FileFormatError, MissingFile
from guara_perception.ranging.range_images import COLUMNS, ROWS
from guara_perception.scan import Scan


def median_stripe_frame(scan: Scan) -> Grey:
    """Grey laser-on frame of the median stripe of the scan."""
    stripe = sorted(scan.stripes, key=lambda each: each.index)[len(scan.stripes) // 2]
    return as_grey(scan.read_frame(stripe.on))


def stripes_together(scan: Scan) -> Grey:
    """The brightest of all laser-on frames at every pixel: all stripes in one image; unreadable frames left out."""
    brightest: Grey | None = None
    for stripe in scan.stripes:
        try:
            frame = as_grey(scan.read_frame(stripe.on))
        except (FileFormatError, MissingFile):
            continue
        if brightest is None:
            brightest = frame
        elif frame.shape == brightest.shape:
            brightest = np.maximum(brightest, frame)
    if brightest is None:
        raise FileFormatError(f"{scan.source}: no laser-on frame can be read")
    return brightest


def as_grey(frame: Image) -> Grey:
    """Grey image of 8 bits; of a colour frame the brightest channel, which shows a laser of any colour."""
    grey = frame.max(axis=2) if frame.ndim == 3 else frame
    return np.asarray(grey >> 8 if grey.dtype == np.uint16 else grey, dtype=np.uint8)


def corrected_image(
    image: Grey, camera: CameraModel, transform_camera_to_footprint: Float, area: tuple[Interval, Interval]
) -> Grey:
    """The image as if seen from straight above the floor: distortion and perspective removed.

    Args:
        image: (h, w) grey levels, pixels of the calibrated camera.
        camera: intrinsic model.
        transform_camera_to_footprint: (4, 4).
        area: x and y range of the floor [m].

    Returns:
        (512, 640), row along x, column along y, black where the camera does not look.
    """
    (x0, x1), (y0, y1) = area
    x = x0 + (np.arange(ROWS) + 0.5) * (x1 - x0) / ROWS
    y = y0 + (np.arange(COLUMNS) + 0.5) * (y1 - y0) / COLUMNS
    floor = np.column_stack((np.repeat(x, COLUMNS), np.tile(y, ROWS), np.zeros(ROWS * COLUMNS)))
    rotation, translation = transform_camera_to_footprint[:3, :3], transform_camera_to_footprint[:3, 3]
    pixels = camera.project((floor - translation) @ rotation)
    source = np.nan_to_num(pixels, nan=-1.0).astype(np.float32).reshape(ROWS, COLUMNS, 2)
    return np.asarray(cv2.remap(image, source, None, cv2.INTER_LINEAR), dtype=np.uint8)  # type: ignore[call-overload]
