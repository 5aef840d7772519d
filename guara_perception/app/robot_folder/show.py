"""Views of a robot in its scan posture, in the browser and as a picture, with scanned area, camera and laser planes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from guara_perception.app.robot_folder.scan_checks import coverage
from guara_perception.app.until_stopped import stop_event
from guara_perception.arrays import Float
from guara_perception.settings import Settings
from guara_perception.terrain.drawing.style import new_figure, save_figure, styled
from guara_perception.terrain.scan.assess_terrain import assess_terrain
from guara_perception.view.browser import BrowserView
from guara_perception.view.moment import Moment
from guara_perception.view.robot_looks import visual_shapes
from kinematics import RobotModel
from kinematics.clearance import shape_points
from kinematics.stance_pose import StancePose
from kinematics.transforms import transform_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Number of points on each drawn line.
POINTS = 300
SOLE = "#0072b2"
CAMERA, LASER, AREA, BAD = "#009e73", "#d55e00", "#56b4e9", "#cc3311"


def show_robot(robot: RobotModel, port: int) -> None:
    """Show a robot in the browser until Ctrl-C or SIGTERM."""
    with stop_event() as stop, BrowserView(robot, port=port) as view:
        view.show_recording([robot_moment(robot)])
        click.echo(f"{robot.name}: open {view.address} (press Ctrl-C to stop)")
        stop.wait()


def robot_moment(robot: RobotModel) -> Moment:
    """Scene of the robot on a flat floor, with the camera cone and the first and last laser plane.

    Ground that is not seen by both camera and laser is unknown.
    """
    settings, covered = Settings.of(robot), coverage(robot)
    heights = np.where(covered.seen, 0.0, np.nan)
    resolution = float(covered.x[1] - covered.x[0])
    origin = (settings.footprint_x[0], settings.footprint_y[0])
    floor = assess_terrain(heights, resolution, origin=origin, limits=settings.limits)
    to_footprint = np.asarray(covered.pose.transform_base_to_footprint)
    grid = floor.restated(
        robot=robot.name, mode="nominal", stance=covered.stance, transform_base_to_footprint=to_footprint
    )
    (near, far), (right, left) = settings.footprint_x, settings.footprint_y
    lines = [_line(covered.camera, np.array([x, y, 0.0])) for x in (near, far) for y in (right, left)]
    for x in covered.planes:
        ends = [np.array([x, y, 0.0]) for y in (right, left)]
        lines += [_line(covered.laser, ends[0]), _line(covered.laser, ends[1]), _line(*ends)]
    return Moment({"footprint": grid}, stripes=lambda: lines)


def _line(start: Float, end: Float) -> Float:
    return start + np.linspace(0.0, 1.0, POINTS)[:, None] * (end - start)


def draw_robot(robot: RobotModel, path: Path) -> None:
    """Draw a robot to a file, from the side and from above; ground that is not seen is red."""
    from matplotlib.patches import Rectangle

    settings, covered = Settings.of(robot), coverage(robot)
    pose, camera, laser = covered.pose, covered.camera, covered.laser
    with styled():
        figure, ((side, top),) = new_figure(1, 2, size=(13.0, 4.0))
        for axes, up in ((side, 2), (top, 1)):
            _draw_links(axes, robot, pose, up)
        (near, far), (right, left) = settings.footprint_x, settings.footprint_y
        side.plot([-1.0, 2.0], [0.0, 0.0], color="0.6", linewidth=0.8, zorder=0)
        side.plot([near, far], [0.0, 0.0], color=AREA, linewidth=4.0, label="scanned area")
        for x in (near, far):
            side.plot([camera[0], x], [camera[2], 0.0], color=CAMERA, linewidth=1.2)
        for x in covered.planes:
            side.plot([laser[0], x], [laser[2], 0.0], color=LASER, linewidth=1.2)
        side.plot(camera[0], camera[2], "o", color=CAMERA, label="camera")
        side.plot(laser[0], laser[2], "s", color=LASER, label="mirror and the first and last laser plane")
        side.set(xlabel="x [m]", ylabel="z [m]", title=f"{robot.name} in its scan posture, from the side")
        top.add_patch(Rectangle((near, right), far - near, left - right, color=AREA, alpha=0.35, label="scanned area"))
        bad = ~covered.seen
        rows, columns = np.nonzero(bad)
        top.plot(covered.x[columns], covered.y[rows], ".", color=BAD, markersize=3, label=f"not seen: {bad.mean():.0%}")
        for x, y in ((near, right), (near, left), (far, right), (far, left)):
            top.plot([camera[0], x], [camera[1], y], color=CAMERA, linewidth=0.8)
        top.plot(camera[0], camera[1], "o", color=CAMERA, label="camera and its cone")
        top.plot(laser[0], laser[1], "s", color=LASER, label="mirror")
        length, width = robot.sole
        for x, y, _ in pose.soles_in_footprint:
            top.add_patch(Rectangle((x - length / 2, y - width / 2), length, width, color=SOLE))
        top.set(xlabel="x [m]", ylabel="y [m]", title="from above")
        for axes in (side, top):
            axes.set_aspect("equal")
            axes.autoscale_view()
            axes.set_xlim(min(float(pose.soles_in_footprint[:, 0].min()) - 0.25, -0.4), far + 0.1)
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, fontsize=8)
        save_figure(figure, path)


def _draw_links(axes: Axes, robot: RobotModel, pose: StancePose, up: int) -> None:
    """Draw the convex outline of each visual shape.

    `up` is the axis that points upwards in the drawing: 2 (z) in the side view, 1 (y) in the view from above.
    """
    from matplotlib.patches import Polygon
    from scipy.spatial import ConvexHull

    shapes = []
    for link, visuals in visual_shapes(robot).items():
        transform = pose.transform_base_to_footprint @ pose.state.transform_to_base(link)
        shapes += [(transform_points(transform, shape_points(shape)), colour) for shape, colour in visuals]
    # Draw shapes farther from the viewer first. The side view is from the right.
    shapes.sort(key=lambda item: -item[0][:, 1].mean() if up == 2 else item[0][:, 2].mean())
    for placed, colour in shapes:
        flat: Float = placed[:, [0, up]]
        outline = flat[ConvexHull(flat).vertices]
        axes.add_patch(Polygon(outline, closed=True, facecolor=colour, edgecolor="white", linewidth=0.4))
