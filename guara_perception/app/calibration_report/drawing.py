"""Figures of the calibration report on camera, mount and laser, as PNG data to embed in the page."""

from __future__ import annotations

import base64
import io
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from guara_perception.app.figures.figures import corrected_image
from guara_perception.arrays import Float, Image
from guara_perception.calibration.calibration import floor_pixels
from guara_perception.calibration.laser import floor_sigmas
from guara_perception.calibration.quality import COVERAGE_CELLS, GRID
from guara_perception.calibration.result import CalibrationResult
from guara_perception.images import to_rgb
from guara_perception.terrain.drawing import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Colours that colour-blind readers can tell apart.
BLUE, ORANGE, GREEN, RED, GREY = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#999999"
SERIES = (BLUE, ORANGE, GREEN, "#cc79a7", "#56b4e9", RED, "#000000")
DPI = 110
GRID_LINES_M = 0.05
FLOOR_LABELS = {"xlabel": "y, left of the robot [m]", "ylabel": "x, ahead of the robot [m]"}
PICTURE_LABELS = {"xlabel": "column [px]", "ylabel": "row [px]"}


def new_figure(width: float = 9.0, height: float = 4.2, columns: int = 1, **options: Any) -> tuple[Figure, list[Any]]:
    """Create a figure with one row of axes; return the figure and the list of its axes."""
    figure, axes = style.new_figure(1, columns, size=(width, height), **options)
    return figure, list(axes[0])


def to_png(figure: Figure) -> bytes:
    """Encode a figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()


def data_url(png: bytes) -> str:
    """Encode a PNG as a data URL, for embedding in the page."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def for_show(picture: Image) -> Image:
    """Convert a camera image to 8-bit RGB with normalised brightness, so that details of dark images are visible."""
    rgb = to_rgb(picture)
    high = max(float(np.percentile(rgb, 99.8)), 1.0)
    return np.clip(rgb * (235.0 / high), 0, 255).astype(np.uint8)


def board_before_after(result: CalibrationResult, name: str) -> bytes:
    """Draw image `name`, of the board on the floor, as taken and as rectified to a view from above.

    The figure corresponds to the paper's Figs. 8 and 9.
    """
    picture = for_show(result.session.read_picture(name))
    figure, (before, after) = new_figure(10.5, 4.4, columns=2)
    before.imshow(picture)
    ground = next(view for view in result.intrinsics.views if view.name == name)
    before.plot(*ground.corners_px.T, ".", color=RED, markersize=3)
    before.set(title="before: as seen by the camera (distorted, in perspective)", **PICTURE_LABELS)
    floor = corrected_image(picture, result.fit.camera, result.fit.transform_camera_to_footprint, result.area)
    # Draw the far side at the top and the left side on the left.
    after.imshow(floor[::-1, ::-1], extent=_floor_extent(result))
    for axis, lines in zip(result.area, (after.axhline, after.axvline), strict=True):
        for tick in range(math.ceil(axis[0] / GRID_LINES_M), math.floor(axis[1] / GRID_LINES_M) + 1):
            lines(tick * GRID_LINES_M, color=GREEN, linewidth=0.4)
    after.set(title="after: straight from above, lines every 50 mm", **FLOOR_LABELS)
    return to_png(figure)


def corner_residuals(result: CalibrationResult) -> bytes:
    """Draw the corner residuals of all images as arrows, and the rms residual of each image."""
    figure, (field, bars) = new_figure(10.5, 4.2, columns=2, width_ratios=(1.35, 1))
    corners = np.concatenate([view.corners_px for view in result.intrinsics.views])
    errors = -np.concatenate(result.fit.residuals_px)
    length = float(np.sqrt((errors**2).sum(axis=1).mean()))
    arrows = field.quiver(
        *corners.T,
        *errors.T,
        angles="xy",
        scale_units="xy",
        scale=length / (0.02 * result.fit.camera.size[0]),
        color=BLUE,
        width=0.0018,
    )
    field.quiverkey(arrows, 0.82, 1.04, 0.1, "0.1 px", labelpos="E")
    _picture_axes(field, result)
    field.set_title("corner errors", loc="left")
    names = [view.name for view in result.intrinsics.views]
    rms = [float(np.sqrt((r**2).sum(axis=1).mean())) for r in result.fit.residuals_px]
    bars.barh(range(len(names)), rms, color=BLUE)
    bars.set_yticks(range(len(names)), names, fontsize=7)
    bars.invert_yaxis()
    bars.set(xlabel="rms corner error [px]", title="error of each picture")
    return to_png(figure)


def coverage_and_sigma(result: CalibrationResult) -> bytes:
    """Draw the number of corners found in each part of the image, and the standard deviation of floor points."""
    figure, (cells, sigma) = new_figure(10.5, 4.2, columns=2)
    width, height = result.fit.camera.size
    cells.imshow(result.coverage, cmap="Greens", vmin=0, extent=(0, width, height, 0), aspect="equal")
    for row, column in np.ndindex(*result.coverage.shape):
        position = ((column + 0.5) * width / COVERAGE_CELLS[0], (row + 0.5) * height / COVERAGE_CELLS[1])
        count = int(result.coverage[row, column])
        dark = count > 0.6 * result.coverage.max()
        cells.text(*position, str(count), ha="center", va="center", color="white" if dark else "black", fontsize=8)
    cells.set_title("board corners seen in each part of the picture")
    _picture_axes(cells, result)
    pixels, floor_sigma = result.floor_sigma
    _contours(figure, sigma, pixels, 1e3 * floor_sigma, "sigma of the floor point [mm]")
    sigma.set_title("standard deviation of floor points")
    _picture_axes(sigma, result)
    return to_png(figure)


def _contours(figure: Figure, axes: Any, pixels: Float, values: Float, label: str) -> None:
    """Draw contours of the values at the pixels of `picture_grid`, with a colour bar."""
    image = values.reshape(GRID[1], GRID[0])
    shown = axes.contourf(pixels[: GRID[0], 0], pixels[:: GRID[0], 1], image, levels=12, cmap="viridis")
    figure.colorbar(shown, ax=axes, label=label, shrink=0.85)


def halves(result: CalibrationResult) -> bytes | None:
    """Draw the difference between two lens models, one fitted to the even-numbered and one to the odd-numbered images.

    Returns None if `result` has no cross-validation.
    """
    if result.cross_validation is None:
        return None
    pixels, difference = result.cross_validation
    figure, (axes,) = new_figure(6.5, 4.0)
    _contours(figure, axes, pixels, np.linalg.norm(difference, axis=1), "difference [px]")
    axes.quiver(*pixels.T, *difference.T, angles="xy", color="white", width=0.003)
    axes.set_title("difference between lens models fitted to the even- and to the odd-numbered pictures")
    _picture_axes(axes, result)
    return to_png(figure)


def fiducials(result: CalibrationResult) -> bytes:
    """Draw enlarged images of up to six crosses, with the detected and the expected position of each."""
    picture = for_show(result.session.read_picture(result.session.fiducials.image))
    marks = result.floor.marks[:6]
    figure, axes = new_figure(1.8 * len(marks) + 1.0, 2.9, columns=len(marks))
    points = result.session.fiducials.points_in_footprint
    predicted = floor_pixels(result.fit.camera, result.fit.transform_camera_to_footprint, points)
    half = 0.028 * result.fit.camera.size[0]
    for axis, mark, expected, point in zip(axes, marks, predicted, points, strict=False):
        axis.imshow(picture)
        axis.plot(*expected, "o", color=GREEN, markersize=13, fillstyle="none", label="expected")
        axis.plot(*mark.centre_px, "+", color=RED, markersize=9, label="found")
        u, v = mark.centre_px
        axis.set(xlim=(u - half, u + half), ylim=(v + half, v - half), xticks=[], yticks=[])
        off = float(np.linalg.norm(mark.centre_px - expected))
        axis.set_title(f"x {point[0]:.3f} y {point[1]:+.3f} m\noff by {off:.2f} px", fontsize=8)
    axes[0].legend(loc="lower left", fontsize=6)
    return to_png(figure)


def _floor_extent(result: CalibrationResult) -> tuple[float, float, float, float]:
    """Extent of an image of the scanned area with its far side at the top and its left side on the left."""
    x, y = result.area
    return y[1], y[0], *x


def _picture_axes(axes: Any, result: CalibrationResult) -> None:
    width, height = result.fit.camera.size
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal", **PICTURE_LABELS)
    axes.tick_params(colors=GREY)


def side_view(result: CalibrationResult) -> bytes:
    """Draw a side view of camera, mirror, laser planes and plates."""
    figure, (axes,) = new_figure(9.5, 4.8)
    stripes, mirror = result.laser.stripes, result.laser.sweep.mirror
    camera_position = result.fit.transform_camera_to_footprint[:3, 3]
    for plane in stripes.planes[:: max(len(stripes.planes) // 24, 1)]:
        heights = np.array([mirror.point[2], 0.0])
        axes.plot(-(plane[2] * heights + plane[3]) / plane[0], heights, color=RED, linewidth=0.5, alpha=0.7)
    for number, plate in enumerate(result.session.plates):
        axes.axhline(
            plate.height, color=SERIES[number % len(SERIES)], linewidth=2, label=f"plate at {1e3 * plate.height:.0f} mm"
        )
    axes.plot(*camera_position[[0, 2]], "s", color=BLUE, markersize=9)
    axes.annotate("camera", camera_position[[0, 2]], xytext=(9, -4), textcoords="offset points")
    axes.plot(*mirror.point[[0, 2]], "^", color=RED, markersize=9)
    axes.annotate("mirror", mirror.point[[0, 2]], xytext=(8, 8), textcoords="offset points")
    axes.axvspan(*result.area[0], ymax=0.02, color=GREY)
    axes.set(xlabel="x, ahead of the robot [m]", ylabel="height [m]", aspect="equal")
    axes.set_title("from the side: red lines are laser planes; the grey bar is the floor area of the other figures")
    axes.legend(loc="upper right", fontsize=8)
    return to_png(figure)


def stripes_over_plate(result: CalibrationResult) -> bytes:
    """Draw the stripes found on the lowest and on the highest plate, each over one frame of the plate's scan."""
    plates = result.session.plates
    chosen = [int(np.argmin([p.height for p in plates])), int(np.argmax([p.height for p in plates]))]
    figure, axes = new_figure(10.5, 4.4, columns=2)
    for axis, number in zip(axes, chosen, strict=True):
        scan = plates[number].scan
        axis.imshow(for_show(scan.read_frame(scan.stripes[len(scan.stripes) // 2].on)))
        own = [line for line in result.lines if line.plate == number]
        for k, line in enumerate(own):
            axis.plot(*line.pixels.T, color=SERIES[k % len(SERIES)], linewidth=0.7)
        axis.set_title(f"{plates[number].name}, {1e3 * plates[number].height:.0f} mm: {len(own)} stripes found")
        width, height = result.fit.camera.size
        axis.set(xlim=(0, width), ylim=(height, 0))
    return to_png(figure)


def plate_errors(result: CalibrationResult) -> bytes:
    """Draw the height error of each stripe on each plate, and of each plate with planes fitted to the other plates.

    The second plot is omitted if there is no leave-one-out result.
    """
    columns = 2 if result.laser.leave_one_out else 1
    figure, axes = new_figure(10.5, 3.8, columns=columns)
    for number, plate in enumerate(result.session.plates):
        own = [
            (line.index, 1e3 * error)
            for line, error in zip(result.lines, result.laser.line_errors, strict=True)
            if line.plate == number
        ]
        axes[0].plot(
            *zip(*sorted(own), strict=True),
            ".-",
            linewidth=0.6,
            markersize=4,
            color=SERIES[number % len(SERIES)],
            label=f"{1e3 * plate.height:.0f} mm",
        )
    axes[0].axhline(0, color=GREY, linewidth=0.8)
    axes[0].set(xlabel="stripe index (near to far)", ylabel="height error [mm]")
    axes[0].set_title("laser planes fitted to all plates")
    axes[0].legend(fontsize=8, title="plate")
    if columns == 2:
        entries = result.laser.leave_one_out
        names = [f"{1e3 * result.session.plates[one.plate].height:.0f} mm" for one in entries]
        position = np.arange(len(entries))
        errors = 1e3 * np.array([(one.near, one.mean, one.far) for one in entries])
        for offset, label in enumerate(("near third", "all", "far third")):
            axes[1].bar(position + 0.25 * (offset - 1), errors[:, offset], 0.24, label=label, color=SERIES[offset])
        axes[1].axhline(0, color=GREY, linewidth=0.8)
        axes[1].set_xticks(position, names)
        axes[1].set(xlabel="plate left out", ylabel="mean height error [mm]")
        axes[1].set_title("laser planes fitted to the other plates")
        axes[1].legend(fontsize=8)
    return to_png(figure)


def mirror_steps(result: CalibrationResult) -> bytes:
    """Draw the angle by which each stripe's laser plane deviates from the one that an ideal mirror would give."""
    figure, (axes,) = new_figure(9.5, 3.4)
    sweep = result.laser.sweep
    axes.plot(sweep.indices, np.rad2deg(2 * sweep.step_errors), ".-", color=BLUE, linewidth=0.8)
    axes.axhline(0, color=GREY, linewidth=0.8)
    axes.set(xlabel="stripe index (near to far)", ylabel="deviation of the laser plane [degrees]")
    jitter = np.rad2deg(result.laser.stripes.jitter)
    axes.set_title(
        f"laser planes compared with an ideal rotating mirror; repeatability from scan to scan {jitter:.4f} degrees"
    )
    return to_png(figure)


def height_sigma(result: CalibrationResult) -> bytes:
    """Draw the predicted sigma of heights across the floor area, in total and from the calibration alone."""
    x, y = np.linspace(*result.area[0], 46), np.linspace(*result.area[1], 55)
    point = np.column_stack((np.repeat(x, y.size), np.tile(y, x.size)))
    planes, to_base = result.laser.stripes.planes, np.asarray(result.calibration.transform_camera_to_base)
    on_floor = -(planes[:, 3] + np.outer(y, planes[:, 1]).mean(axis=0)) / planes[:, 0]
    nearest = np.abs(point[:, :1] - on_floor).argmin(axis=1)
    sigmas = floor_sigmas(result.fit, result.laser, result.lines, to_base, point, nearest)
    titles = "one return: noise and calibration together", "calibration alone"
    figure, axes = new_figure(10.5, 4.2, columns=2)
    for axis, sigma, title in zip(axes, sigmas, titles, strict=True):
        image = 1e3 * sigma.reshape(x.size, y.size)
        shown = axis.imshow(image[::-1, ::-1], extent=_floor_extent(result), cmap="viridis", vmin=0)
        figure.colorbar(shown, ax=axis, label="sigma of height [mm]", shrink=0.85)
        axis.set(title=title, **FLOOR_LABELS)
    return to_png(figure)
