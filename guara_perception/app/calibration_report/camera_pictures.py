"""Pictures of the report about camera and mount."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.app.calibration_report.drawing import BLUE, GREEN, GREY, RED, for_show, new_figure, to_png
from guara_perception.arrays import Image
from guara_perception.calibration.floor_lines import floor_pixels
from guara_perception.calibration.quality import COVERAGE_CELLS, GRID
from guara_perception.calibration.result import CalibrationResult

# The paper's rectified picture: 540 x 450 mm of floor.
AREA_X, AREA_Y = (0.50, 0.95), (-0.27, 0.27)


def board_before_after(result: CalibrationResult) -> bytes:
    """The board on the floor as the camera sees it and as seen straight from above: the paper's Figs. 8 and 9."""
    picture = for_show(result.session.read_picture(result.session.ground_board_image))
    figure, (before, after) = new_figure(10.5, 4.4, columns=2)
    before.imshow(picture)
    ground = next(view for view in result.intrinsics.views if view.name == result.session.ground_board_image)
    before.plot(*ground.corners_px.T, ".", color=RED, markersize=3)
    before.set_title("before: as the camera sees it (bent and in perspective)")
    before.set_xlabel("column [px]")
    before.set_ylabel("row [px]")
    after.imshow(floor_picture(result, picture), extent=(AREA_Y[1], AREA_Y[0], AREA_X[0], AREA_X[1]))
    for x in np.arange(AREA_X[0], AREA_X[1] + 1e-9, 0.05):
        after.axhline(x, color=GREEN, linewidth=0.4)
    for y in np.arange(-0.25, 0.26, 0.05):
        after.axvline(y, color=GREEN, linewidth=0.4)
    after.set_title("after: straight from above, lines every 50 mm")
    after.set_xlabel("y, left of the robot [m]")
    after.set_ylabel("x, ahead of the robot [m]")
    return to_png(figure)


def floor_picture(result: CalibrationResult, picture: Image) -> Image:
    """A picture rectified to the floor area, far side up, left side left."""
    x = np.linspace(AREA_X[1], AREA_X[0], 512)
    y = np.linspace(AREA_Y[1], AREA_Y[0], 640)
    grid = np.column_stack((np.repeat(x, y.size), np.tile(y, x.size)))
    pixels = floor_pixels(result.fit.camera, result.fit.transform_camera_to_footprint, grid)
    maps = np.nan_to_num(pixels, nan=-1.0).astype(np.float32).reshape(x.size, y.size, 2)
    return np.asarray(cv2.remap(picture, maps[:, :, 0], maps[:, :, 1], cv2.INTER_LINEAR), dtype=np.uint8)


def corner_residuals(result: CalibrationResult) -> bytes:
    """Arrows from where corners should be to where they are, and the error of each view."""
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
    bars.set_xlabel("rms corner error [px]")
    bars.set_title("error of each picture")
    return to_png(figure)


def coverage_and_sigma(result: CalibrationResult) -> bytes:
    """Where corners were seen, and how far a floor point may be off."""
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
    image = 1e3 * floor_sigma.reshape(GRID[1], GRID[0])
    shown = sigma.contourf(pixels[: GRID[0], 0], pixels[:: GRID[0], 1], image, levels=12, cmap="viridis")
    figure.colorbar(shown, ax=sigma, label="sigma of the floor point [mm]", shrink=0.85)
    sigma.set_title("how far a point of the floor may be off")
    _picture_axes(sigma, result)
    return to_png(figure)


def halves(result: CalibrationResult) -> bytes | None:
    """Difference between two lens models, each from every other picture; None where there were too few pictures."""
    if result.cross_validation is None:
        return None
    pixels, difference = result.cross_validation
    figure, (axes,) = new_figure(6.5, 4.0)
    size = np.sqrt((difference**2).sum(axis=1))
    shown = axes.contourf(
        pixels[: GRID[0], 0], pixels[:: GRID[0], 1], size.reshape(GRID[1], GRID[0]), levels=12, cmap="viridis"
    )
    figure.colorbar(shown, ax=axes, label="difference [px]", shrink=0.85)
    axes.quiver(*pixels.T, *difference.T, angles="xy", color="white", width=0.003)
    axes.set_title("two lenses, each from every other picture")
    _picture_axes(axes, result)
    return to_png(figure)


def fiducials(result: CalibrationResult) -> bytes:
    """Each cross enlarged, with the position found and the position expected."""
    picture = for_show(result.session.read_picture(result.session.fiducials.image))
    marks = result.floor.marks[:6]
    figure, axes = new_figure(1.8 * len(marks) + 1.0, 2.9, columns=len(marks))
    predicted = floor_pixels(
        result.fit.camera, result.fit.transform_camera_to_footprint, result.session.fiducials.points_in_footprint
    )
    half = 0.028 * result.fit.camera.size[0]
    for axis, mark, expected, point in zip(
        axes, marks, predicted, result.session.fiducials.points_in_footprint, strict=False
    ):
        axis.imshow(picture)
        axis.plot(*expected, "o", color=GREEN, markersize=13, fillstyle="none", label="expected")
        axis.plot(*mark.centre_px, "+", color=RED, markersize=9, label="found")
        axis.set_xlim(mark.centre_px[0] - half, mark.centre_px[0] + half)
        axis.set_ylim(mark.centre_px[1] + half, mark.centre_px[1] - half)
        off = float(np.linalg.norm(mark.centre_px - expected))
        axis.set_title(f"x {point[0]:.3f} y {point[1]:+.3f} m\noff by {off:.2f} px", fontsize=8)
        axis.set_xticks([])
        axis.set_yticks([])
    axes[0].legend(loc="lower left", fontsize=6)
    return to_png(figure)


def _picture_axes(axes: object, result: CalibrationResult) -> None:
    width, height = result.fit.camera.size
    axes.set_xlim(0, width)  # type: ignore[attr-defined]
    axes.set_ylim(height, 0)  # type: ignore[attr-defined]
    axes.set_aspect("equal")  # type: ignore[attr-defined]
    axes.set_xlabel("column [px]")  # type: ignore[attr-defined]
    axes.set_ylabel("row [px]")  # type: ignore[attr-defined]
    axes.tick_params(colors=GREY)  # type: ignore[attr-defined]
