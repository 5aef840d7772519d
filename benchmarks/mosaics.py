"""Scans of Bayer mosaics (as they are, red pixels, red filled in, demosaiced) beside grey and colour pictures.

`python -m benchmarks light mosaics`: one rendered scan in each form, and its errors away from edges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from benchmarks.command import Table, options
from benchmarks.rounds import alternate
from benchmarks.scans import process
from drivers.cameras.bayer import mosaic, red_pixels
from guara_perception.arrays import Image
from guara_perception.calibration.calibration import Calibration
from testbed.scenes import simulated

SIZE = (640, 512)
PATTERN = "BayerRG8"
RED = 2
# Bilinear interpolation between red pixels, which lie two pixels apart.
TENT = np.array([0.5, 1.0, 0.5], np.float32)
REPEATS = 3


def forms() -> dict[str, Callable[[Image], Image]]:
    """Functions by name, each of which makes from a colour picture what a camera or a driver could deliver."""
    return {
        "colour, three whole channels": lambda picture: picture,
        "grey camera (red plane)": lambda picture: np.ascontiguousarray(picture[:, :, RED]),
        "mosaic as it is": lambda picture: mosaic(picture, PATTERN),
        "mosaic, red pixels only": lambda picture: red_pixels(mosaic(picture, PATTERN), PATTERN),
        "mosaic, red filled in": lambda picture: fill_red(mosaic(picture, PATTERN)),
        "mosaic, demosaiced": lambda picture: cv2.cvtColor(mosaic(picture, PATTERN), cv2.COLOR_BayerRGGB2BGR),
    }


def fill_red(mosaic_picture: Image) -> Image:
    """The red channel of a mosaic at every pixel, interpolated bilinearly between red pixels."""
    red = np.zeros_like(mosaic_picture)
    red[::2, ::2] = mosaic_picture[::2, ::2]
    filled: Image = cv2.sepFilter2D(red, -1, TENT, TENT, borderType=cv2.BORDER_REFLECT_101)
    return filled


def halved(calibration: Calibration) -> Calibration:
    """The calibration for pictures of every second row and column, beginning with the first."""
    camera = calibration.camera
    matrix = camera.matrix.copy()
    matrix[:2] *= 0.5
    small = replace(camera, size=(camera.size[0] // 2, camera.size[1] // 2), matrix=matrix)
    return replace(calibration, camera=small)


def main() -> None:
    """Scans of Bayer mosaics, grey and colour pictures beside the truth."""
    options(__doc__)
    scan = simulated(SIZE)
    off, truth = scan.frames[0][2], scan.truth
    assert truth is not None
    print(f"{SIZE[0]} x {SIZE[1]} px, {len(scan.frames)} stripes, one off frame; processor time without making mosaics")
    head = "frames: | known cells:.4f | rms of the better 99 % mm:.3f | 99th percentile mm:.2f | ms a stripe:.2f"
    table = Table(head, markdown=True)
    for name, form in forms().items():
        dark = form(off)
        frames = tuple((index, form(on), dark) for index, on, _ in scan.frames)
        is_half = dark.shape[0] == SIZE[1] // 2
        seen = replace(scan, frames=frames, calibration=halved(scan.calibration) if is_half else scan.calibration)
        timings = alternate({name: partial(process, seen, "precise")}, REPEATS)
        elevation = timings.results[name].elevation
        errors = np.sort(1e3 * np.abs(elevation - truth.mean)[truth.interior & np.isfinite(elevation)])
        # Without known cells there are no errors.
        errors = errors if errors.size else np.array([np.nan])
        rms = np.sqrt(np.mean(errors[: int(np.ceil(0.99 * errors.size))] ** 2))
        known, each_ms = np.isfinite(elevation).mean(), timings.milliseconds(name, per=len(frames))
        table.row(name, known, rms, np.percentile(errors, 99), each_ms)
