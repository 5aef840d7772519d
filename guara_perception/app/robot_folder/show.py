"""Shows a robot in the browser as it stands to scan: its area, the camera's cone and the laser planes."""

from __future__ import annotations

import click
import numpy as np

from guara_perception.app.robot_folder.scan_checks import coverage
from guara_perception.app.until_stopped import stop_event
from guara_perception.arrays import Float
from guara_perception.settings import Settings
from guara_perception.terrain.scan.assess_terrain import assess_terrain
from guara_perception.view.browser import BrowserView
from guara_perception.view.moment import Moment
from kinematics import RobotModel, Stance

# Points along each drawn line.
POINTS = 300


def show_robot(robot: RobotModel, port: int) -> None:
    """Serve the view until Ctrl-C."""
    with stop_event() as stop, BrowserView(robot, port=port) as view:
        view.show_recording([robot_moment(robot)])
        click.echo(f"{robot.name}: open {view.address} (Ctrl-C ends)")
        stop.wait()


def robot_moment(robot: RobotModel) -> Moment:
    """The robot over a flat floor: seen where camera and laser reach, unknown elsewhere; lines for cone and laser."""
    settings, seen = Settings.of(robot), coverage(robot)
    stance = Stance(robot.posture(robot.config.scan_posture), robot.legs)
    pose = robot.stance_pose(stance, find_unloaded=False)
    heights = np.where(seen.in_view & ~seen.hidden & seen.lit, 0.0, np.nan)
    resolution = float(seen.x[1] - seen.x[0])
    origin = (settings.footprint_x[0], settings.footprint_y[0])
    floor = assess_terrain(heights, resolution, origin=origin, limits=settings.limits)
    to_footprint = np.asarray(pose.transform_base_to_footprint)
    grid = floor.restated(robot=robot.name, mode="nominal", stance=stance, transform_base_to_footprint=to_footprint)
    camera = (pose.transform_base_to_footprint @ robot.transform_camera_to_base)[:3, 3]
    laser = (pose.transform_base_to_footprint @ np.append(robot.transform_laser_to_base[:3, 3], 1.0))[:3]
    (near, far), (right, left) = settings.footprint_x, settings.footprint_y
    lines = [_line(camera, np.array([x, y, 0.0])) for x in (near, far) for y in (right, left)]
    for angle in settings.mirror_angles:
        x = laser[0] + laser[2] * np.tan(2.0 * angle)
        ends = [np.array([x, y, 0.0]) for y in (right, left)]
        lines += [_line(laser, ends[0]), _line(laser, ends[1]), _line(*ends)]
    return Moment({"footprint": grid}, stripes=lambda: lines)


def _line(start: Float, end: Float) -> Float:
    return start + np.linspace(0.0, 1.0, POINTS)[:, None] * (end - start)
