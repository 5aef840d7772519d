"""Grids and stances as messages and back, for all of the program.

A grid that breaks the safety invariant is refused on both sides.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from guara_perception.exceptions import UnsafeGrid
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import check_invariant
from kinematics import Stance
from transport import Health, ObstacleMessage, StanceMessage, TerrainMessage, TransformMessage

HEALTH = {"ok": Health.OK, "degraded": Health.WARN, "failed": Health.ERROR}


def terrain_to_message(
    terrain: TerrainGrid,
    *,
    robot: str,
    sequence: int,
    scan_start: int | None = None,
    scan_end: int | None = None,
    valid_for: float = math.inf,
    stated: Mapping[str, Any] | None = None,
) -> TerrainMessage:
    """The message of a grid.

    Args:
        terrain: grid that came out of a scan or out of the fused map.
        robot: instance name of the robot.
        sequence: number of this message.
        scan_start, scan_end: first and last frame [ns since the epoch]; None = the grid's stamp.
        valid_for: at most this long after `scan_end`, besides the grid's own validity [s].
        stated: entries to add to the grid's own metadata; they replace entries of the same name.

    Raises:
        UnsafeGrid: the grid breaks the safety invariant.
    """
    check_invariant(terrain.layers)
    data = {**terrain.metadata, **(stated or {})}
    stance = data.get("stance", {"joint_positions": {}, "support_feet": [], "gravity_in_base": None})
    health = data.get("health", {})
    start = terrain.stamp if scan_start is None else scan_start
    return TerrainMessage(
        robot=robot,
        extent=terrain.extent,
        sequence=sequence,
        step=terrain.step,
        stamp=terrain.stamp,
        scan_start=start,
        scan_end=max(start, terrain.stamp if scan_end is None else scan_end),
        valid_for=min(float(data.get("validity_seconds", math.inf)), valid_for),
        # The frame of a scan's own grid ends with its pause.
        valid_pauses=0 if terrain.extent == "footprint" else int(data.get("validity_pauses", 255)),
        mode=str(data.get("mode", "standard")),
        method=str(data.get("method", "")),
        calibration_hash=str(data.get("calibration_hash", "")),
        resolution=terrain.resolution,
        origin=terrain.origin,
        layers=terrain.layers,
        stance=StanceMessage(
            joint_positions=stance["joint_positions"],
            support_feet=tuple(stance["support_feet"]),
            gravity_in_base=None if stance["gravity_in_base"] is None else tuple(stance["gravity_in_base"]),
        ),
        attitude_source=str(data.get("attitude_source", "level")),
        transforms=_transforms(data),
        obstacles=_obstacles(terrain),
        point_counts=data.get("points", {}),
        stage_ms={name: 1e3 * seconds for name, seconds in data.get("seconds", {}).items()},
        coverage=float(data.get("coverage", 0.0)),
        health=HEALTH.get(str(health.get("level", "ok")), Health.WARN),
        health_reasons=tuple(health.get("reasons", ())),
        metadata=json.dumps(data),
        frame_id=terrain.frame,
    )


def message_to_terrain(message: TerrainMessage) -> TerrainGrid:
    """The grid of a message.

    Raises:
        UnsafeGrid: its layers break the safety invariant, by a defect of the sender or damage on the way.
    """
    metadata = json.loads(message.metadata)
    metadata.update(
        sequence=message.sequence, scan_start=message.scan_start, scan_end=message.scan_end, instance=message.robot
    )
    layers = {name: np.asarray(array) for name, array in message.layers.items()}
    try:
        ny, nx = message.shape
        return TerrainGrid(
            layers=layers,
            geometry=GridGeometry(message.origin, message.resolution, (ny, nx)),
            frame=message.frame_id,
            stamp=message.stamp,
            step=message.step,
            extent=message.extent,
            metadata=metadata,
            stale_because=message.stale_because,
        )
    except UnsafeGrid as error:
        raise UnsafeGrid(f"grid received from {message.robot!r}, step {message.step}: {error}") from None


def stance_to_message(stance: Stance) -> StanceMessage:
    """The message of a stance."""
    return StanceMessage(
        joint_positions=stance.joint_positions,
        support_feet=stance.support_feet,
        gravity_in_base=stance.gravity_in_base,
    )


def message_to_stance(message: StanceMessage) -> Stance:
    """The stance of a message.

    Raises:
        kinematics.KinematicsError: it cannot be one: a foot twice, gravity that points up.
    """
    return Stance(message.joint_positions, message.support_feet, message.gravity_in_base)


def restamped(terrain: TerrainGrid, stamp: int, step: int | None = None) -> TerrainGrid:
    """The same grid at another time [ns] (and pause): a replay is published as if it were scanned now."""
    return dataclasses.replace(terrain, stamp=stamp, step=terrain.step if step is None else step)


def _transforms(data: Mapping[str, Any]) -> tuple[TransformMessage, ...]:
    pairs = (
        ("base_link", "base_footprint", "transform_base_to_footprint", "pose_covariance"),
        ("camera_optical_frame", "base_link", "transform_camera_to_base", ""),
        ("base_footprint", "odom", "transform_footprint_to_odom", "odometry_covariance"),
    )
    return tuple(
        TransformMessage(
            source_frame=source,
            destination_frame=destination,
            matrix=np.array(data[name]),
            covariance=np.array(data[covariance_key]) if data.get(covariance_key) is not None else None,
        )
        for source, destination, name, covariance_key in pairs
        if data.get(name) is not None
    )


def _obstacles(terrain: TerrainGrid) -> tuple[ObstacleMessage, ...]:
    return tuple(
        ObstacleMessage(
            outline=np.asarray(item.outline),
            height=item.height,
            position=tuple(item.position),
            sigma=item.sigma,
            hazard=int(item.hazard),
        )
        for item in terrain.obstacles()
    )
