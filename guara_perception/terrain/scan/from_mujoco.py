"""Ground of a MuJoCo scene as a terrain grid, for the same queries as on the robot."""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.exceptions import InvalidInput, optional_library
from guara_perception.settings import RobotLike, Settings
from guara_perception.terrain.assessment.raster import merge, rasterise, without_cells
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard
from guara_perception.terrain.scan.from_points import judged_grid, prepare_grid
from kinematics import KinematicsError, RobotModel, Stance, describe_robot
from kinematics.stance_pose import support_soles
from kinematics.transforms import inverse, transform_points

Area = tuple[tuple[float, float], tuple[float, float]]
# Number of rays per cell along each axis. With cells of 5 mm they may miss relief narrower than 2.5 mm.
RAYS = 2
# Height above the highest geom at which the rays start; a ray that starts inside a geom would meet its bottom. Rays
# meet any ceiling first, so the ground under it is unknown.
ABOVE_M = 1.0


def terrain_from_mujoco(
    model: Any,
    data: Any,
    *,
    robot: RobotLike | None = None,
    body: str | None = None,
    support_feet: tuple[str, ...] | None = None,
    area: Area | None = None,
    resolution: float | None = None,
    step: int = 0,
) -> TerrainGrid:
    """Make a grid of extent "footprint" from the ground around a robot in a MuJoCo scene.

    Vertical rays sample the ground: all geoms of the scene that can collide and are not part of the robot. Heights are
    exact, and there is no occlusion as seen from the robot; only ground below an overhang is hidden. A cell with a ray
    that meets nothing, or something outside the height limits of the robot, is OUT_OF_RANGE.

    Args:
        model: `mujoco.MjModel` of the scene, with the joint names of the robot's URDF.
        data: `mujoco.MjData` of the model, with up-to-date positions (`mujoco.mj_forward`).
        robot: model, name or folder; defines the soles, the limits and the area; None = the Guará.
        body: name of the robot's base in the scene; None = the robot's base frame.
        support_feet: legs that stand; None = all. Their soles define z = 0, as at a stance pause.
        area: ((x_min, x_max), (y_min, y_max)) in base_footprint [m]; None = the area of a scan.
        resolution: cell edge [m]; None = the robot's default. It must divide the area.
        step: number of the stance pause.

    Raises:
        InvalidInput: there is no such body or joint, the scene has no ground, its state is not finite, the robot does
            not stand, the area is invalid, or the resolution is not positive, does not divide the area or gives too
            many cells.
        kinematics.KinematicsError: the robot cannot be loaded.
        MissingExtra: MuJoCo is not installed (extra `sim`).
    """
    mujoco = optional_library("mujoco", "sim", "a grid of a MuJoCo scene")
    robot, settings, geometry = prepare_grid(robot, resolution, area)
    base = _body(model, body or robot.config.base_frame)
    # A geom that cannot collide, such as a visual mesh, does not support a foot.
    ground = ~_is_own(model, base)[model.geom_bodyid] & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    if not ground.any():
        raise InvalidInput(
            "the scene has no ground: it needs at least one geom that can collide and is not part of the robot"
        )
    stance, transform_base_to_world = _stance(model, data, robot, base, support_feet)
    try:
        pose = robot.stance_pose(stance)
    except KinematicsError as error:
        raise InvalidInput(f"the robot in the scene does not stand: {error}") from None
    transform_footprint_to_world = transform_base_to_world @ inverse(pose.transform_base_to_footprint)
    points = _ground(mujoco, model, data, ground, geometry, transform_footprint_to_world, settings)
    within = (points[:, 2] >= settings.minimum_height) & (points[:, 2] <= settings.maximum_height)
    hazard = np.zeros(geometry.shape, np.uint16)
    iy, ix = geometry.indices(points[~within, 0], points[~within, 1])
    hazard[iy, ix] = np.uint16(Hazard.OUT_OF_RANGE)
    raster = without_cells(merge([rasterise(points[within], np.zeros(within.sum()), geometry)], geometry), hazard != 0)
    stamp = round(float(data.time) * 1e9)
    grid = judged_grid(raster, hazard, geometry, robot, "mujoco", int(within.sum()), stamp, step)
    record = dataclasses.replace(
        grid.record,
        robot_description=describe_robot(robot),
        stance=stance,
        attitude_source=pose.attitude_source,
        support_feet_used=pose.support_feet_used,
        support_soles=support_soles(pose, robot.noise),
        transform_base_to_footprint=pose.transform_base_to_footprint,
    )
    return dataclasses.replace(grid, record=record)


def _body(model: Any, name: str) -> int:
    names = [model.body(index).name for index in range(model.nbody)]
    if name not in names[1:]:
        known = ", ".join(sorted(filter(None, names[1:]))[:20])
        raise InvalidInput(f"body is {name!r}; allowed: a body of the scene ({known})")
    return names.index(name)


def _is_own(model: Any, base: int) -> Mask:
    """Mask of the robot's bodies: its base and all descendants of the base."""
    own = np.zeros(model.nbody, dtype=bool)
    own[base] = True
    # A body comes after its parent.
    for index in range(base + 1, model.nbody):
        own[index] = own[model.body_parentid[index]]
    return own


def _stance(
    model: Any, data: Any, robot: RobotModel, base: int, support_feet: tuple[str, ...] | None
) -> tuple[Stance, Float]:
    """Stance of the robot in the scene, and transform_base_to_world (4, 4)."""
    if not (np.isfinite(data.qpos).all() and np.isfinite(data.xpos).all() and np.isfinite(data.xmat).all()):
        raise InvalidInput("the state of the scene contains NaN or infinity: has the simulation diverged?")
    named = {model.joint(index).name: index for index in range(model.njnt)}
    missing = sorted(set(robot.joint_names) - set(named))
    if missing:
        raise InvalidInput(
            f"the scene lacks joints of robot {robot.name!r}: {', '.join(missing)}; pass the scene's robot as `robot`"
        )
    positions = {name: float(data.qpos[model.jnt_qposadr[named[name]]]) for name in robot.joint_names}
    transform_base_to_world = np.eye(4)
    transform_base_to_world[:3, :3] = data.xmat[base].reshape(3, 3)
    transform_base_to_world[:3, 3] = data.xpos[base]
    down_x, down_y, down_z = (-float(value) for value in transform_base_to_world[2, :3])
    try:
        stance = Stance(positions, support_feet or robot.legs, (down_x, down_y, down_z))
    except KinematicsError as error:
        raise InvalidInput(f"the robot in the scene does not stand: {error}") from None
    return stance, transform_base_to_world


def _ground(
    mujoco: Any, model: Any, data: Any, ground: Mask, geometry: GridGeometry, transform: Float, settings: Settings
) -> Float:
    """Highest ground (n, 3) at several points of each cell, in base_footprint [m]; z is -inf if a ray meets nothing."""
    # Only the ground is visible in this copy, because rays pass through invisible geoms.
    model = copy.copy(model)
    model.geom_matid[:], model.geom_rgba[:, 3] = -1, ground
    ny, nx = geometry.shape
    shares = (np.arange(RAYS) + 0.5) / RAYS
    x = geometry.origin[0] + (np.arange(nx)[:, None] + shares).ravel() * geometry.resolution
    y = geometry.origin[1] + (np.arange(ny)[:, None] + shares).ravel() * geometry.resolution
    # The footprint is horizontal. Planes have no radius; their rays are infinite downwards.
    highest = float((data.geom_xpos[ground, 2] + model.geom_rbound[ground]).max())
    top = max(settings.maximum_height, highest - transform[2, 3]) + ABOVE_M
    points = np.stack(np.broadcast_arrays(x[None, :], y[:, None], top), axis=-1).reshape(-1, 3)
    down, met = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)
    starts = transform_points(transform, points)
    distances = np.array([mujoco.mj_ray(model, data, start, down, None, 1, -1, met) for start in starts])
    points[:, 2] = np.where(distances < 0.0, -np.inf, top - distances)
    return points
