"""Conversion of grids and stances to messages and back.

Sender and receiver both reject a grid that violates the safety invariant.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from guara_perception.exceptions import UnsafeGrid, errors_as
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import check_invariant
from guara_perception.terrain.layers.record import RECORDS, GridRecord, Health, MapRecord, ScanRecord
from kinematics import BodyTrack, RobotModel, Stance
from transport import Health as Level
from transport import ObstacleMessage, StanceMessage, StanceStream, TerrainMessage, TransformMessage

LEVELS = {"ok": Level.OK, "degraded": Level.WARN, "failed": Level.ERROR}


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
    """Convert a grid to its message.

    Args:
        terrain: grid of a scan or of the fused map.
        robot: instance name of the robot.
        sequence: sequence number of this message.
        scan_start, scan_end: times of the first and last frame [ns since the Unix epoch]; None = the grid's stamp.
        valid_for: upper limit of the grid's validity after `scan_end` [s].
        stated: fields of the record to replace in the message.

    Raises:
        UnsafeGrid: the grid violates the safety invariant.
        InvalidInput: a field of the grid's record has a value that a receiver cannot read back.
    """
    check_invariant(terrain.layers)
    record = dataclasses.replace(terrain.record, **(stated or {}))
    record.check()
    health, seconds, pauses = record.health or Health(), record.validity_seconds, record.validity_pauses
    scan = record if isinstance(record, ScanRecord) else ScanRecord()
    start = terrain.stamp if scan_start is None else scan_start
    return TerrainMessage(
        robot=robot,
        extent=terrain.extent,
        sequence=sequence,
        step=terrain.step,
        stamp=terrain.stamp,
        scan_start=start,
        scan_end=max(start, terrain.stamp if scan_end is None else scan_end),
        valid_for=valid_for if seconds is None else min(float(seconds), valid_for),
        # A scan's grid is not moved to base_footprint of later pauses, so it is valid for its pause only.
        valid_pauses=0 if terrain.extent == "footprint" else 255 if pauses is None else pauses,
        mode=record.mode or "standard",
        method=record.method or "",
        calibration_hash=record.calibration_hash or "",
        resolution=terrain.resolution,
        origin=terrain.origin,
        layers=terrain.layers,
        stance=stance_to_message(record.stance or Stance({}, ())),
        attitude_source=record.attitude_source or "level",
        transforms=_transforms(record),
        obstacles=_obstacles(terrain),
        point_counts=scan.points or {},
        stage_ms={name: 1e3 * spent for name, spent in (scan.seconds or {}).items()},
        coverage=float(record.coverage or 0.0),
        health=LEVELS.get(health.level, Level.WARN),
        health_reasons=health.reasons,
        metadata=json.dumps(dict(record.to_json())),
        frame_id=terrain.frame,
    )


def message_to_terrain(message: TerrainMessage) -> TerrainGrid:
    """Convert a message to the grid that was sent.

    Raises:
        UnsafeGrid: the layers violate the safety invariant, because of a fault in the sender or corruption in transit.
    """
    stated = {
        "sequence": message.sequence,
        "scan_start": message.scan_start,
        "scan_end": message.scan_end,
        "instance": message.robot,
    }
    layers = {name: np.asarray(array) for name, array in message.layers.items()}
    with errors_as(UnsafeGrid, f"grid received from {message.robot!r}, step {message.step}", UnsafeGrid):
        ny, nx = message.shape
        return TerrainGrid(
            layers=layers,
            geometry=GridGeometry(message.origin, message.resolution, (ny, nx)),
            frame=message.frame_id,
            stamp=message.stamp,
            step=message.step,
            extent=message.extent,
            record=RECORDS[message.extent].from_json({**json.loads(message.metadata), **stated}),
            stale_because=message.stale_because,
        )


def stance_to_message(stance: Stance) -> StanceMessage:
    """Convert a stance to its message."""
    return StanceMessage(
        joint_positions=stance.joint_positions,
        support_feet=stance.support_feet,
        gravity_in_base=stance.gravity_in_base,
    )


def message_to_stance(message: StanceMessage) -> Stance:
    """Convert a message to the stance that was sent.

    Raises:
        kinematics.KinematicsError: the stance is invalid, for instance a foot is named twice or gravity points up.
    """
    return Stance(message.joint_positions, message.support_feet, message.gravity_in_base)


def _transforms(record: GridRecord) -> tuple[TransformMessage, ...]:
    found = [
        ("base_link", "base_footprint", record.transform_base_to_footprint, record.pose_covariance),
        ("camera_optical_frame", "base_link", record.transform_camera_to_base, None),
    ]
    if isinstance(record, MapRecord):
        found.append(("base_footprint", "odom", record.transform_footprint_to_odom, record.odometry_covariance))
    return tuple(
        TransformMessage(source_frame=source, destination_frame=destination, matrix=matrix, covariance=covariance)
        for source, destination, matrix, covariance in found
        if matrix is not None
    )


def _obstacles(terrain: TerrainGrid) -> tuple[ObstacleMessage, ...]:
    names = "outline", "height", "position", "sigma", "hazard"
    return tuple(ObstacleMessage(**{name: getattr(item, name) for name in names}) for item in terrain.obstacles())


def add_samples(track: BodyTrack, robot: RobotModel, batch: StanceStream, begin: int) -> None:
    """Add a batch of joint samples to a track, with times relative to `begin` [ns].

    Samples that are not later than the newest sample of the track are dropped.

    Raises:
        kinematics.KinematicsError: the batch lacks a joint of the robot, a position is not finite, or the stamps do not
            ascend.
    """
    stamps, names = batch.stamps, list(batch.joint_names)
    times = (stamps - begin) * 1e-9
    later = times > track.latest
    order = [names.index(name) for name in robot.tree.joint_names if name in names]
    carries = np.zeros((len(times), len(robot.legs)), dtype=bool)
    for column, leg in enumerate(robot.legs):
        if leg in batch.legs:
            carries[:, column] = np.asarray(batch.supports)[:, batch.legs.index(leg)]
    track.add(times[later], np.asarray(batch.joint_positions)[later][:, order], carries[later])
