"""Pictures of the report about the laser."""

from __future__ import annotations

import numpy as np

from guara_perception.app.calibration_report.camera_pictures import AREA_X, AREA_Y
from guara_perception.app.calibration_report.drawing import BLUE, GREY, RED, SERIES, for_show, new_figure, to_png
from guara_perception.calibration.laser import heights_through
from guara_perception.calibration.plates import level_pixels
from guara_perception.calibration.result import CalibrationResult


def side_view(result: CalibrationResult) -> bytes:
    """Camera, mirror, laser planes and plates from the side."""
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
    axes.axvspan(*AREA_X, ymax=0.02, color=GREY)
    axes.set_xlabel("x, ahead of the robot [m]")
    axes.set_ylabel("height [m]")
    axes.set_title("from the side: each red line is one laser plane; the grey bar is the scanned area")
    axes.set_aspect("equal")
    axes.legend(loc="upper right", fontsize=8)
    return to_png(figure)


def stripes_over_plate(result: CalibrationResult) -> bytes:
    """The lines found on the lowest and on the highest plate, over one of its frames."""
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
        axis.set_xlim(0, result.fit.camera.size[0])
        axis.set_ylim(result.fit.camera.size[1], 0)
    return to_png(figure)


def plate_errors(result: CalibrationResult) -> bytes:
    """Height error of every stripe on every plate, and of each plate through the planes of the others."""
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
    axes[0].set_xlabel("stripe index (near to far)")
    axes[0].set_ylabel("height error [mm]")
    axes[0].set_title("plates measured with their own planes")
    axes[0].legend(fontsize=8, title="plate")
    if columns == 2:
        entries = result.laser.leave_one_out
        names = [f"{1e3 * result.session.plates[one.plate].height:.0f} mm" for one in entries]
        position = np.arange(len(entries))
        for offset, (label, values) in enumerate(
            (
                ("near third", [one.near for one in entries]),
                ("all", [one.mean for one in entries]),
                ("far third", [one.far for one in entries]),
            )
        ):
            axes[1].bar(position + 0.25 * (offset - 1), 1e3 * np.array(values), 0.24, label=label, color=SERIES[offset])
        axes[1].axhline(0, color=GREY, linewidth=0.8)
        axes[1].set_xticks(position, names)
        axes[1].set_xlabel("plate left out")
        axes[1].set_ylabel("mean height error [mm]")
        axes[1].set_title("plates measured with the planes of the others")
        axes[1].legend(fontsize=8)
    return to_png(figure)


def mirror_steps(result: CalibrationResult) -> bytes:
    """How the laser plane of each stripe strays from the ideal mirror."""
    figure, (axes,) = new_figure(9.5, 3.4)
    sweep = result.laser.sweep
    axes.plot(sweep.indices, np.rad2deg(2 * sweep.step_errors), ".-", color=BLUE, linewidth=0.8)
    axes.axhline(0, color=GREY, linewidth=0.8)
    axes.set_xlabel("stripe index (near to far)")
    axes.set_ylabel("laser plane off by [degrees]")
    jitter = np.rad2deg(result.laser.stripes.jitter)
    axes.set_title(
        f"laser planes against an ideal turning mirror; from scan to scan they repeat within {jitter:.4f} degrees"
    )
    return to_png(figure)


def height_sigma(result: CalibrationResult) -> bytes:
    """Predicted sigma of one height all over the floor, noise and calibration together, and calibration alone."""
    x, y = np.linspace(*AREA_X, 46), np.linspace(*AREA_Y, 55)
    point = np.column_stack((np.repeat(x, y.size), np.tile(y, x.size)))
    stripes, transform = result.laser.stripes, result.fit.transform_camera_to_footprint
    pixels = level_pixels(result.fit.camera, transform, point, 0.0)
    below = pixels + np.array([0.0, 1.0])
    in_camera = (np.column_stack((point, np.zeros(len(point)))) - transform[:3, 3]) @ transform[:3, :3]
    to_base = np.asarray(result.calibration.transform_camera_to_base)
    on_floor = -(stripes.planes[:, 3] + np.outer(y, stripes.planes[:, 1]).mean(axis=0)) / stripes.planes[:, 0]
    nearest = np.abs(point[:, :1] - on_floor).argmin(axis=1)
    noise = float(np.median([line.sigma_px for line in result.lines]))
    by_row, systematic = np.full(len(point), np.nan), np.full(len(point), np.nan)
    for k in np.unique(nearest):
        is_near = nearest == k
        plane = stripes.planes[k]
        moved = heights_through(below[is_near], result.fit.camera, transform, plane)
        by_row[is_near] = moved - heights_through(pixels[is_near], result.fit.camera, transform, plane)
        systematic[is_near] = result.laser.uncertainty.variance(
            stripes.indices[k], result.laser.planes_in_camera[k], in_camera[is_near], to_base, transform[2, :3]
        )
    both = 1e3 * np.sqrt((by_row * noise) ** 2 + systematic).reshape(x.size, y.size)
    alone = 1e3 * np.sqrt(systematic).reshape(x.size, y.size)
    figure, axes = new_figure(10.5, 4.2, columns=2)
    for axis, image, title in (
        (axes[0], both, "one return: noise and calibration together"),
        (axes[1], alone, "calibration alone"),
    ):
        shown = axis.imshow(
            image[::-1, ::-1], extent=(AREA_Y[1], AREA_Y[0], AREA_X[0], AREA_X[1]), cmap="viridis", vmin=0
        )
        figure.colorbar(shown, ax=axis, label="sigma of height [mm]", shrink=0.85)
        axis.set_title(title)
        axis.set_xlabel("y, left of the robot [m]")
        axis.set_ylabel("x, ahead of the robot [m]")
    return to_png(figure)
