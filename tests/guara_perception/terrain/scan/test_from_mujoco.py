"""Grids of MuJoCo scenes, compared with the shapes of the scene."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from kinematics import RobotModel

pytestmark = [
    pytest.mark.sim,
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("mujoco") is None, reason="MuJoCo is not installed (extra `sim`)"),
]
# Centre and half sizes of a box, and its top [m].
BOX, HALF, TOP = (0.70, 0.05), (0.10, 0.08), 0.04
FLOOR = '<geom name="floor" type="plane" size="5 5 0.1"/>'
STEP = f'<geom name="box" type="box" pos="{BOX[0]} {BOX[1]} {TOP / 2}" size="{HALF[0]} {HALF[1]} {TOP / 2}" {{}}/>'


def scene(robot: RobotModel, ground: str, *, yaw: float = 0.0, at: tuple[float, float] = (0.0, 0.0)) -> tuple[Any, Any]:
    """The Guará's MJCF in its scan posture on this ground."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(robot.folder / "mjcf" / "guara.xml"))
    child = mujoco.MjSpec.from_string(f"<mujoco><worldbody><body name='ground'>{ground}</body></worldbody></mujoco>")
    spec.attach(child, prefix="world_", frame=spec.worldbody.add_frame())
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, robot.posture_names.index(robot.config.scan_posture))
    data.qpos[:2] = at
    data.qpos[3:7] = (np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2))
    mujoco.mj_forward(model, data)
    return model, data


def test_heights_are_those_of_the_scene(robot: RobotModel) -> None:
    """Floor and box only; the edge of the box is a step; the record has the stance, as queries with a leg need."""
    model, data = scene(robot, FLOOR + STEP.format(""))
    terrain = gp.terrain_from_mujoco(model, data)
    lowest = data.xpos[model.body("base_link").id][2] - 0.360
    assert terrain.height_at(0.60, -0.20) == pytest.approx(-lowest, abs=1e-3)
    assert terrain.height_at(*BOX) == pytest.approx(TOP - lowest, abs=1e-3)
    assert terrain.is_traversable(0.60, -0.15) and terrain.is_traversable(*BOX)
    assert not terrain.is_traversable(BOX[0] + HALF[0], BOX[1])
    assert terrain.check_foothold(0.60, -0.15).ok and terrain.record.stance is not None
    wide = gp.terrain_from_mujoco(model, data, area=((-0.6, 1.0), (-0.35, 0.35)))
    assert wide.best_foothold(0.40, -0.18, 0.05, leg="rf") is not None
    assert terrain.record.method == "mujoco" and terrain.record.attitude_source == "imu"


def test_the_grid_goes_with_the_robot(robot: RobotModel) -> None:
    """The same grid after robot and ground are rotated and moved together."""
    yaw, at = 0.7, (1.3, -0.4)
    still = gp.terrain_from_mujoco(*scene(robot, FLOOR + STEP.format("")))
    frame = f'<frame pos="{at[0]} {at[1]} 0" euler="0 0 {np.degrees(yaw)}">{STEP.format("")}</frame>'
    moved = gp.terrain_from_mujoco(*scene(robot, FLOOR + frame, yaw=yaw, at=at))
    np.testing.assert_allclose(moved.elevation, still.elevation, atol=1e-6)
    np.testing.assert_array_equal(moved.hazard, still.hazard)


@pytest.mark.parametrize("drawn", ['rgba="1 0 0 0"', 'rgba="1 0 0 1"'])
def test_what_is_invisible_is_solid_all_the_same(robot: RobotModel, drawn: str) -> None:
    model, data = scene(robot, FLOOR + STEP.format(drawn))
    assert gp.terrain_from_mujoco(model, data).height_at(*BOX) > TOP / 2
    assert model.geom("world_box").rgba[3] in (0.0, 1.0) and model.geom("world_box").rgba[0] == 1.0


def test_what_bears_nothing_is_no_ground(robot: RobotModel) -> None:
    """A visual geom over a hole does not count: the hole is out of range, with no free cell above it."""
    frame = "".join(
        f'<geom type="box" pos="{x} {y} -0.5" size="{a} {b} 0.5"/>'
        for x, y, a, b in ((-0.85, 0, 1.45, 2), (1.8, 0, 1.0, 2), (0.7, 1.05, 0.1, 1.0), (0.7, -1.05, 0.1, 1.0))
    )
    picture = '<geom type="box" pos="0.7 0 -0.005" size="0.1 0.05 0.005" contype="0" conaffinity="0"/>'
    terrain = gp.terrain_from_mujoco(*scene(robot, frame + picture))
    assert terrain.hazard_at(0.70, 0.0) & gp.Hazard.OUT_OF_RANGE
    assert np.isnan(terrain.height_at(0.70, 0.0))
    x, y = (axis.ravel() for axis in np.meshgrid(*terrain.geometry.centres()))
    free = (terrain.hazard == 0).ravel()
    assert free.any() and not (free & (np.abs(x - 0.7) < 0.1) & (np.abs(y) < 0.05)).any()


def test_a_ceiling_leaves_the_ground_unknown(robot: RobotModel) -> None:
    """Its lower side gives no height; the robot's own parts are no ceiling."""
    roof = '<geom type="box" pos="0.7 0 1.0" size="0.1 0.1 0.1"/>'
    terrain = gp.terrain_from_mujoco(*scene(robot, FLOOR + roof), area=((-0.6, 1.0), (-0.35, 0.35)))
    assert terrain.hazard_at(0.70, 0.0) & gp.Hazard.OUT_OF_RANGE
    assert terrain.elevation.shape == (140, 320)
    assert np.isfinite(terrain.height_at(0.0, 0.0)) and np.isfinite(terrain.height_at(0.30, 0.18))


@pytest.mark.parametrize("height", [19.0, 30.0, 2000.0])
def test_the_inside_of_a_high_wall_is_no_ground(robot: RobotModel, height: float) -> None:
    """Rays start above whatever stands in the scene, in a pit too; from within, they would meet the floor."""
    wall = f'<geom type="box" pos="0.7 0 {height / 2}" size="0.12 0.15 {height / 2}"/>'
    terrain = gp.terrain_from_mujoco(*scene(robot, FLOOR + wall))
    x, y = np.meshgrid(*terrain.geometry.centres())
    inside = (np.abs(x - 0.7) < 0.12) & (np.abs(y) < 0.15)
    assert ((terrain.hazard[inside] & gp.Hazard.OUT_OF_RANGE) != 0).all()
    assert terrain.is_traversable(0.90, 0.0) is False and (terrain.hazard[~inside] == 0).any()


def test_bad_scenes_are_refused(robot: RobotModel) -> None:
    model, data = scene(robot, FLOOR)
    with pytest.raises(gp.InvalidInput, match="body is 'trunk'; allowed: a body of the scene"):
        gp.terrain_from_mujoco(model, data, body="trunk")
    with pytest.raises(gp.InvalidInput, match="the scene lacks joints of robot 'tapir': "):
        gp.terrain_from_mujoco(model, data, robot="tests/robots/tapir", body="base_link")
    with pytest.raises(gp.InvalidInput, match="area is"):
        gp.terrain_from_mujoco(model, data, area=((0.9, 0.5), (-0.2, 0.2)))
    with pytest.raises(gp.InvalidInput, match="resolution"):
        gp.terrain_from_mujoco(model, data, resolution=-1.0)
    with pytest.raises(gp.InvalidInput, match="does not stand"):
        gp.terrain_from_mujoco(model, data, support_feet=("lf", "xx"))
    with pytest.raises(gp.InvalidInput, match="the scene has no ground"):
        gp.terrain_from_mujoco(*scene(robot, '<geom type="box" size="1 1 1" contype="0" conaffinity="0"/>'))
    data.qpos[7] = np.nan
    with pytest.raises(gp.InvalidInput, match="contains NaN or infinity"):
        gp.terrain_from_mujoco(model, data)


def test_a_fallen_robot_is_refused(robot: RobotModel) -> None:
    import mujoco

    model, data = scene(robot, FLOOR)
    data.qpos[3:7] = (0.0, 1.0, 0.0, 0.0)
    mujoco.mj_forward(model, data)
    with pytest.raises(gp.InvalidInput, match="the robot in the scene does not stand"):
        gp.terrain_from_mujoco(model, data)
