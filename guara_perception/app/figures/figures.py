"""Figures of a scan: Figs. 13 to 18 of the paper, hazards, range images. Views from above: x up, y to the left."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from guara_perception.app.files.range_files import write_range_images
from guara_perception.arrays import Float, Float32, Grey, Image, Interval, Mask
from guara_perception.calibration.calibration import Calibration, CameraModel, floor_pixels
from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile
from guara_perception.files import check_folder
from guara_perception.images import eight_bits
from guara_perception.scan import Scan
from guara_perception.scanning.pictures import COLUMNS, ROWS, cause_image
from guara_perception.scanning.scan_processor import ScanProcessor
from guara_perception.terrain.drawing.style import (
    TRAVERSABILITY_COLOURS,
    draw_layer,
    new_figure,
    rgb,
    save_figure,
)
from guara_perception.terrain.drawing.style import draw_hazards as draw_flags
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import Hazard

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import Patch

Extent = tuple[float, float, float, float]
SIZE = (9.6, 6.4)
# Colour of the hatching and text of the legend, by cause of unknown cells. The colours are from a palette for
# colour-blind readers; black and grey are distinguished from heights by the hatching.
CAUSES = {
    Hazard.DROPOUT: ("#d55e00", "no return (dark or hole)"),
    Hazard.OCCLUDED: ("#56b4e9", "hidden from camera or laser"),
    Hazard.UNSCANNED: ("#999999", "not observed"),
    Hazard.OUT_OF_RANGE: ("#000000", "below or above the height limits"),
    Hazard.AMBIGUOUS: ("#cc79a7", "unreliable return"),
    Hazard.SELF: ("#0072b2", "hidden by the robot itself"),
}
OTHER_COLOUR = "#888888"
# Width of the hatching lines in pixels of a range image.
LINE_PX = 5


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
        FileFormatError, MissingFile: the frame of the median stripe cannot be read, or no laser-on frame can be read.
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
    return np.asarray(eight_bits(frame.max(axis=2) if frame.ndim == 3 else frame), dtype=np.uint8)


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


def draw_image(path: Path, image: Grey, area: tuple[Interval, Interval] | None, title: str) -> Path:
    """Draw a greyscale image to a file; return the path.

    If `area` is None, the image is a frame with axes in pixels; otherwise it shows this area [m] of the floor from
    above, with axes in millimetres.
    """
    figure, ((axes,),) = new_figure(size=SIZE)
    if area is None:
        axes.imshow(image, cmap="gray", vmin=0, vmax=255)
        axes.set(xlabel="u [px]", ylabel="v [px]")
    else:
        axes.imshow(image[::-1, ::-1], cmap="gray", vmin=0, vmax=255, extent=_extent(area))
        _label(axes)
    axes.set_title(title)
    return save_figure(figure, path)


def draw_range_image(
    path: Path, image: Float32, terrain: TerrainGrid | None, area: tuple[Interval, Interval], title: str
) -> Path:
    """Draw a range image [mm] to a file, with higher ground lighter; return the path.

    Unknown pixels are hatched, with a colour for each cause if a grid is given.
    """
    figure, ((axes,),) = new_figure(size=SIZE)
    known = image[np.isfinite(image)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    extent = _extent(area)
    shown = axes.imshow(
        np.ma.masked_invalid(image[::-1, ::-1]), cmap="gray", vmin=low, vmax=max(high, low + 1), extent=extent
    )
    figure.colorbar(shown, ax=axes, label="height above the soles [mm]", shrink=0.85)
    remaining, handles = np.isnan(image), []
    flags = np.zeros(image.shape, np.uint8) if terrain is None else cause_image(terrain)
    for cause, (colour, label) in CAUSES.items():
        mask = remaining & ((flags & int(cause)) != 0)
        handles += _hatch(axes, mask, extent, colour, label)
        remaining &= ~mask
    # Pixels are smaller than cells, so a pixel without a cause in the grid lies between the samples of a known cell.
    rest = "unknown" if terrain is None else "between samples of a known cell"
    handles += _hatch(axes, remaining, extent, OTHER_COLOUR, rest)
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.11), ncols=3)
    _label(axes)
    axes.set_title(title)
    return save_figure(figure, path)


def draw_surface(path: Path, terrain: TerrainGrid, title: str) -> Path:
    """Draw the heights of a grid as a 3-D surface with holes at unknown cells; return the path of the file."""
    import matplotlib
    from matplotlib.colors import LightSource, Normalize

    axes: Any
    figure, ((axes,),) = new_figure(size=SIZE, subplot_kw={"projection": "3d"})
    x, y = (1e3 * centres for centres in terrain.geometry.centres())
    height = 1e3 * terrain.elevation.astype(np.float64)
    known = height[np.isfinite(height)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    scale = Normalize(low, max(high, low + 1))
    colours = matplotlib.colormaps["viridis"](scale(np.nan_to_num(height, nan=low)))
    shade = LightSource(azdeg=315, altdeg=50).hillshade(np.nan_to_num(height, nan=low), vert_exag=1.5, dx=5, dy=5)
    colours[..., :3] *= (0.55 + 0.45 * shade)[..., None]
    across, along = np.meshgrid(y, x, indexing="ij")
    axes.plot_surface(across, along, height, facecolors=colours, rstride=1, cstride=1, linewidth=0, antialiased=False)
    bottom, top = min(low, 0.0), max(high, 60.0)
    axes.set(xlim=(y[-1], y[0]), ylim=(x[0], x[-1]), zlim=(bottom, top))
    axes.set_box_aspect((np.ptp(y), np.ptp(x), 2.0 * (top - bottom)))
    axes.set(xlabel="y, left [mm]", ylabel="x, forward [mm]", zlabel="height [mm] (vertical exaggeration 2)")
    axes.view_init(elev=42, azim=-112)
    mappable = matplotlib.cm.ScalarMappable(norm=scale, cmap="viridis")
    figure.colorbar(mappable, ax=axes, label="height above the soles [mm]", shrink=0.7)
    axes.set_title(title)
    return save_figure(figure, path)


def draw_hazards(path: Path, terrain: TerrainGrid, title: str) -> Path:
    """Draw traversability and hazards side by side; return the path of the file.

    In the right plot, a cell with several flags has the colour of the first of them in `style.HAZARD_COLOURS`.
    """
    figure, ((score, hazards),) = new_figure(1, 2, size=(11.0, 4.0))
    traversability = np.where(np.isfinite(terrain.elevation), terrain.traversability, np.nan)
    shown = draw_layer(score, terrain.geometry, traversability, cmap=TRAVERSABILITY_COLOURS, vmin=0, vmax=1)
    figure.colorbar(shown, ax=score, label="traversability", shrink=0.8)
    draw_flags(hazards, terrain.geometry, terrain.hazard)
    figure.suptitle(title)
    return save_figure(figure, path)


def _extent(area: tuple[Interval, Interval]) -> Extent:
    (x0, x1), (y0, y1) = area
    return (1e3 * y1, 1e3 * y0, 1e3 * x0, 1e3 * x1)


def _label(axes: Axes) -> None:
    axes.set(xlabel="y, left [mm]", ylabel="x, forward [mm]", aspect="equal")


def _hatch(axes: Axes, mask: Mask, extent: Extent, colour: str, label: str) -> list[Patch]:
    """Hatch the pixels of a mask (rows along x, columns along y); return a list with the legend entry.

    The list is empty if no pixel is set.
    """
    from matplotlib.patches import Patch

    if not mask.any():
        return []
    shown = mask[::-1, ::-1]
    is_line = (np.add.outer(np.arange(shown.shape[0]), np.arange(shown.shape[1])) // LINE_PX) % 2 == 0
    rgba = np.zeros((*shown.shape, 4))
    rgba[..., :3] = np.where(is_line[..., None], rgb(colour), 0.45 * np.array(rgb(colour)) + 0.55)
    rgba[..., 3] = shown
    axes.imshow(rgba, extent=extent, interpolation="nearest")
    return [Patch(facecolor=colour, edgecolor="white", hatch="//", label=label)]
