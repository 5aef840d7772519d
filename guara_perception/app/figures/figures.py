"""Draws the pictures of the paper's Figs. 13 to 18, a map of hazards and the range images as files, from any scan."""

from __future__ import annotations

from pathlib import Path

from guara_perception.app.figures.figure_frames import corrected_image, median_stripe_frame, stripes_together
from guara_perception.app.figures.figure_maps import draw_hazards, draw_image, draw_range_image, draw_surface
from guara_perception.app.files.range_files import write_range_images
from guara_perception.arrays import Grey
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import InvalidInput
from guara_perception.scan import Scan
from guara_perception.scan_processor import ScanProcessor
from guara_perception.terrain.grid import TerrainGrid


def draw_figures(
    folder: str | Path, scan: Scan, calibration: Calibration, processor: ScanProcessor, terrain: TerrainGrid
) -> list[Path]:
    """Write all pictures of a processed scan into a folder, which is made when it is not there.

    Args:
        folder: where to write.
        scan: the recording; its frames are read again.
        calibration: calibration that the scan was processed with.
        processor: processor of the scan, after all its stripes.
        terrain: grid of the scan, with pictures (`with_pictures`).

    Returns:
        Paths of the files, in the order of the paper's figures.

    Raises:
        InvalidInput: the grid carries no range images, or the folder is a file.
    """
    folder = Path(folder)
    if "ortho_image_mm" not in terrain.pictures:
        raise InvalidInput("the grid carries no range images: make them with `with_pictures` before drawing")
    if folder.exists() and not folder.is_dir():
        raise InvalidInput(f"{folder} is a file, the pictures need a folder")
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
            f"All {len(scan.stripes)} laser stripes (Fig. 15)",
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
        draw_surface(folder / "fig18_surface.png", terrain, "Orthorectified range image in 3-D (Fig. 18)"),
        draw_hazards(folder / "hazards.png", terrain, "Where a foot may go, and why not elsewhere"),
        *write_range_images(folder, terrain),
    ]
