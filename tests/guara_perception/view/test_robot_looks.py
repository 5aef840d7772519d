"""Tests of how a robot is drawn."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from guara_perception.settings import Settings
from guara_perception.view.robot_looks import BODY_COLOUR, LEG_COLOUR, visual_shapes
from kinematics import RobotModel, load_robot
from kinematics.clearance import shape_points
from kinematics.self_filter import place_shape
from kinematics.transforms import transform_points

ROBOTS = ("guara", str(Path(__file__).parents[2] / "robots" / "tapir"))


def with_text(robot: RobotModel, text: str) -> RobotModel:
    """A stand-in that has the robot's shapes and another text of its URDF."""
    tree = SimpleNamespace(urdf=dataclasses.replace(robot.tree.urdf, text=text), links=robot.tree.links)
    return SimpleNamespace(tree=tree, config=robot.config)  # type: ignore[return-value]


@pytest.mark.parametrize("name", ROBOTS)
def test_every_shape_is_drawn_where_it_is(name: str) -> None:
    """The drawn robot stands on its soles."""
    robot = load_robot(name)
    state = robot.state(robot.posture(robot.config.scan_posture))
    visuals = visual_shapes(robot)
    assert {link for link, description in robot.tree.links.items() if description.shapes} <= set(visuals)
    lowest = []
    for link, shapes in visuals.items():
        transform = state.transform_to_base(link)
        for shape, _ in shapes:
            lowest.append(transform_points(transform, shape_points(shape))[:, 2].min())
    assert min(lowest) == pytest.approx(state.soles_in_base()[:, 2].mean(), abs=0.02)


def test_the_guara_has_the_colours_of_its_materials(robot: RobotModel) -> None:
    """Materials are found by name; every link with a body is drawn, the sensors too."""
    visuals = visual_shapes(robot)
    assert visuals["base_link"][0][1] == (0.62, 0.27, 0.13)
    assert {"camera_link", "laser_link", "lf_thigh_link", "rh_foot_link"} <= set(visuals)
    assert sum(map(len, visuals.values())) == robot.tree.urdf.text.count("<visual>") == 62


def test_collision_shapes_stand_in_for_what_is_no_plain_visual(robot: RobotModel) -> None:
    """No visual, a mesh, a shape that is broken: the link is drawn by what collides, in the colour of its part."""
    text = robot.tree.urdf.text
    bare = visual_shapes(with_text(robot, re.sub(r"<visual>.*?</visual>", "", text, flags=re.DOTALL)))
    assert {link: len(shapes) for link, shapes in bare.items()} == {
        link: len(found.shapes) for link, found in robot.tree.links.items() if found.shapes
    }
    assert bare["base_link"][0][1] == BODY_COLOUR and bare["lf_thigh_link"][0][1] == LEG_COLOUR
    motor = '<cylinder radius="0.034" length="0.120"/>'
    for broken in (
        '<mesh filename="motor.stl"/>',
        '<cylinder radius="-1" length="1"/>',
        "<box/>",
        '<sphere radius="x"/>',
    ):
        visuals = visual_shapes(with_text(robot, text.replace(motor, broken, 1)))
        assert len(visuals["base_link"]) == 1 and visuals["base_link"][0][1] == BODY_COLOUR
        assert len(visuals["lf_thigh_link"]) == 3
    unknown = visual_shapes(with_text(robot, text.replace('rgba="0.62 0.27 0.13 1"', 'rgba="red"')))
    assert unknown["base_link"][0][1] == BODY_COLOUR


def test_what_carries_the_sensors_stands_in_nobodys_way(robot: RobotModel) -> None:
    """Body, mast, boom and sensor bodies hide no cell of the area from camera or laser."""
    visuals = visual_shapes(robot)
    state = robot.state(robot.posture("scan"))
    settings = Settings.of(robot)
    floor = state.soles_in_base()[:, 2].mean()
    x, y = np.meshgrid(np.linspace(*settings.footprint_x, 10), np.linspace(*settings.footprint_y, 10))
    cells = np.column_stack((x.ravel(), y.ravel(), np.full(x.size, floor)))
    camera = robot.transform_camera_to_base[:3, 3]
    mirror = robot.transform_laser_to_base[:3, 3]
    drawn = [(link, shape) for link in ("base_link", "camera_link", "laser_link") for shape, _ in visuals[link]]
    hit: list[str] = []
    for origin, own in ((camera, "camera_link"), (mirror, "laser_link")):
        for link, shape in drawn:
            placed = place_shape(shape, link, state.transform_to_base(link), 0.0)
            # The mirror itself lies on the axis; what leaves it starts below its housing.
            start = origin + (cells - origin) * (0.06 if link == own else 0.0)
            if placed.blocks(start, cells - start).any():
                hit.append(f"{own}: {link}")
    assert hit == []
