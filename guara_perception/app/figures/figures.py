"""Files with figures of a scan: Figs. 13 to 18 of the paper, the hazards and the range images."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from guara_perception.app.figures.figure_maps import draw_hazards, draw_image, draw_range_image, draw_surface
from guara_perception.app.files.range_files import write_range_images
from guara_perception.arrays import Float, Grey, Image, Interval
from guara_perception.calibration.calibration import Calibration, CameraModel, floor_pixels
from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile
from guara_perception.files import check_folder
from guara_perception.ranging.range_images import COLUMNS, ROWS
from guara_perception.scan import Scan
from guara_perception.scanning.scan_processor import ScanProcessor
from guara_perception.terrain.grid import TerrainGrid


def draw_figures(
    folder: str | Path, scan: Scan, calibration: Calibration, processor: ScanProcessor, terrain: TerrainGrid
) -> list[Path]:
    """Write all figures of a processed scan to a folder, which is created if needed.

    Args:
        folder: folder to write to.
        scan: the recorded scan, whose frames are read again.
        calibration: calibration with which the scan was processed.
        processor: processor to which all stripes of the scan were added.
        terrain: grid of the scan, with range images (`with_pictures`).

    Returns:
        Paths of the files, in the order of the paper's figures, followed by hazards and range images.

    Raises:
        InvalidInput: the grid has no range images, or `folder` is not a folder.
        FileFormatError, MissingFile: the frame of the median stripe, or every laser-on frame, cannot be read.
    """
    folder = Path(folder)
    if "ortho_image_mm" not in terrain.pictures:
        raise InvalidInput("the grid has no range images: add them with `with_pictures` before drawing")
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    area = (processor.settings.footprint_x, processor.settings.footprint_y)
    transform = processor.transform_camera_to_footprint
    raw = median_stripe_frame(scan)

    def corrected(image: Grey) -> Grey:
        return corrected_image(image, calibration.camera, transform, area)

    perspective, ortho = terrain.pictures["range_image_mm"], terrain.pictures["ortho_image_mm"]
    return [
        draw_image(folder / "fig13_original_frame.png", raw, None, "Original frame (Fig. 13)"),
        draw_image(
            folder / "fig14_corrected_frame.png",
            corrected(raw),
            area,
            "Distortion and perspective corrected: the floor plane (Fig. 14)",
        ),
        draw_image(
            folder / "fig15_laser_stripes.png",
            corrected(stripes_together(scan)),
            area,
            "Laser stripes (Fig. 15)",
        ),
        draw_range_image(
            folder / "fig16_perspective_range_image.png", perspective, None, area, "Perspective range image (Fig. 16)"
        ),
        draw_range_image(
            folder / "fig17_orthorectified_range_image.png",
            ortho,
            terrain,
            area,
            "Orthorectified range image, top view (Fig. 17)",
        ),
        draw_surface(folder / "fig18_surface.png", terrain, "Elevation grid in 3-D (Fig. 18)"),
        draw_hazards(folder / "hazards.png", terrain, "Traversability and hazards"),
        *write_range_images(folder, terrain),
    ]


def median_stripe_frame(scan: Scan) -> Grey:
    """Greyscale laser-on frame of the median stripe of the scan."""
    stripe = sorted(scan.stripes, key=lambda each: each.index)[len(scan.stripes) // 2]
    return as_grey(scan.read_frame(stripe.on))


def stripes_together(scan: Scan) -> Grey:
    """Maximum of all readable laser-on frames at each pixel, which shows all stripes in one image.

    Frames whose size differs from that of the first are skipped.

    Raises:
        FileFormatError: no laser-on frame can be read.
    """
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
    """Convert a frame to 8-bit greyscale: the maximum of its channels, which shows a laser of any colour."""
    grey = frame.max(axis=2) if frame.ndim == 3 else frame
    return np.asarray(grey >> 8 if grey.dtype == np.uint16 else grey, dtype=np.uint8)


def corrected_image(
    image: Image, camera: CameraModel, transform_camera_to_footprint: Float, area: tuple[Interval, Interval]
) -> Image:
    """Rectify an image to a top view of the floor, without lens distortion or perspective.

    Args:
        image: (h, w) or (h, w, 3) 8-bit image of the calibrated camera.
        camera: intrinsic model.
        transform_camera_to_footprint: (4, 4) pose of the camera in base_footprint.
        area: x and y range of the floor, in base_footprint [m].

    Returns:
        (512, 640) or (512, 640, 3) image with rows along x and columns along y, black outside the camera's view.
    """
    (x0, x1), (y0, y1) = area
    x = x0 + (np.arange(ROWS) + 0.5) * (x1 - x0) / ROWS
    y = y0 + (np.arange(COLUMNS) + 0.5) * (y1 - y0) / COLUMNS
    floor = np.column_stack((np.repeat(x, COLUMNS), np.tile(y, ROWS)))
    pixels = floor_pixels(camera, transform_camera_to_footprint, floor)
    source = np.nan_to_num(pixels, nan=-1.0).astype(np.float32).reshape(ROWS, COLUMNS, 2)
    return np.asarray(cv2.remap(image, source, None, cv2.INTER_LINEAR), dtype=np.uint8)  # type: ignore[call-overload]
