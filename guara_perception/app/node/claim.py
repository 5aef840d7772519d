"""Claim of a journal: the walk at a confirmed pause, which a restarted node checks before it goes on from it.

Joints alone cannot tell a robot that was carried with stiff legs, or turned on flat ground, from one that stood. So the
walk goes on only if the gait says which feet never left the ground, and joints, gravity, the first scan and its
laser-off picture all fit.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import FileFormatError
from guara_perception.fields import Fields, parse_json
from guara_perception.files import read_bounded
from guara_perception.ground_picture import GroundPicture
from guara_perception.settings import Settings
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.map.terrain_map import TerrainMap
from kinematics import KinematicsError, LegOdometry, OdometryPose, RobotModel, Stance
from kinematics.footholds import Footholds
from kinematics.odometry import OdometryState
from kinematics.stance_pose import sole_covariances
from kinematics.transforms import transform_points

FORMAT = "guara-journal/1"
# [byte] A journal has 1 to 4 MB.
LARGEST_JOURNAL = 64 * 1024 * 1024
# The clock of scans begins anew when the machine does; this file names its present run.
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
# Files of a robot folder on which a map depends.
ROBOT_FILES = {".urdf", ".srdf", ".toml"}
# Feet that must have stood: with fewer the motion since is not known.
LEAST_STANDING = 2
# How far the first picture may lie beside where odometry puts it [m, rad]: feet that slide and noise of all joints make
# a third of it in two pauses.
MOST_ASIDE_M, MOST_TURN_RAD = 0.010, np.radians(1.0)
# Soles that stayed kept their heights within this number of sigmas.
HEIGHT_SIGMAS = 4.0
# The first scan must show this share of its ground in the map, and contradict that nowhere but in this share of it, by
# more than these sigmas and this height [m].
LEAST_SHARED, MOST_CONTRADICTING, SCAN_SIGMAS, SCAN_M = 0.25, 0.10, 3.0, 0.005


@dataclass(frozen=True, slots=True)
class Seal:
    """What a journal must have in common with the node that goes on from it.

    Attributes:
        instance: instance name.
        robot: digest of the robot's folder.
        calibration: hash of the calibration.
        boot: run of the machine.
    """

    instance: str
    robot: str
    calibration: str
    boot: str

    @classmethod
    def of(cls, instance: str, robot: RobotModel, calibration: Calibration) -> Seal:
        """That of a node on this machine."""
        digest = hashlib.sha256()
        for file in sorted(path for path in robot.folder.rglob("*") if path.suffix in ROBOT_FILES):
            digest.update(file.name.encode() + b"\0" + file.read_bytes())
        boot = BOOT_ID.read_text().strip() if BOOT_ID.is_file() else ""
        return cls(instance, digest.hexdigest(), calibration.hash, boot)


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """Walk after a confirmed pause.

    Attributes:
        epoch: identity of the walk, as the gait gives it.
        step, stance: the pause.
        time: end of its scan by `transport.clock` [s].
        odometry, map: state of both.
        restarts: reasons why the map began anew so far.
    """

    epoch: str
    step: int
    stance: Stance
    time: float
    odometry: OdometryState
    map: TerrainMap
    restarts: tuple[str, ...] = ()

    def write(self, stream: IO[bytes], seal: Seal) -> None:
        """Write a file of three parts: format and digest of the rest, what is claimed as JSON, and the map."""
        claimed = {
            **dataclasses.asdict(seal),
            "epoch": self.epoch,
            "step": self.step,
            "time": self.time,
            "stance": self.stance.to_dict(),
            "odometry": dataclasses.asdict(self.odometry),
            "restarts": self.restarts,
        }
        head = len(FORMAT) + 1 + hashlib.sha256().digest_size * 2 + 1
        stream.seek(head)
        stream.write(json.dumps(claimed, default=np.ndarray.tolist).encode() + b"\n")
        self.map.write(stream)
        stream.flush()
        stream.seek(head)
        digest = hashlib.sha256(stream.read()).hexdigest()
        stream.seek(0)
        stream.write(f"{FORMAT} {digest}\n".encode())

    @classmethod
    def read(cls, path: Path, robot: RobotModel, seal: Seal) -> Claim:
        """Read a file of `write`.

        Raises:
            FileFormatError: it is damaged, too long, of another version, or does not fit the seal.
        """
        head, _, body = read_bounded(path, LARGEST_JOURNAL).partition(b"\n")
        kind, _, digest = head.decode(errors="replace").partition(" ")
        if kind != FORMAT:
            raise FileFormatError(f"{path}: its format is {kind[:40]!r}, allowed: {FORMAT!r}")
        if hashlib.sha256(body).hexdigest() != digest:
            raise FileFormatError(f"{path}: its digest does not fit: it is cut or damaged")
        fields = parse_json(body.partition(b"\n")[0], str(path))
        for name, value in dataclasses.asdict(seal).items():
            given = fields.text(name)
            if given != value:
                raise FileFormatError(f"{path}: it is of {name} {given[:40]!r}, this node has {value[:40]!r}")
        try:
            return cls(
                epoch=fields.text("epoch"),
                step=fields.integer("step"),
                time=fields.number("time", 0.0),
                stance=Stance.from_dict(fields.sub("stance").data),
                odometry=_odometry(fields.sub("odometry"), robot),
                map=TerrainMap.load(path, robot),
                restarts=tuple(map(str, fields.sequence("restarts"))),
            )
        except KinematicsError as error:
            raise FileFormatError(f"{path}: {error}") from None

    def misfit(
        self,
        stance: Stance,
        terrain: TerrainGrid,
        odometry: LegOdometry,
        standing: Sequence[str],
        *,
        time: float,
        picture: GroundPicture | str | None,
    ) -> str:
        """Reason why the first scan of a restarted node does not fit; empty if it does.

        Args:
            stance: stance of its pause.
            terrain: grid of the scan alone.
            odometry: one of this robot, without a pause; it gets this pause.
            standing: feet that never left the ground since the pause of the claim, as the gait says.
            time: end of the scan by `transport.clock` [s].
            picture: laser-off picture of the scan, as `TerrainMap.update` takes it.
        """
        robot = self.map.robot
        age, validity = time - self.time, Settings.of(robot).validity_seconds
        if len(standing) < LEAST_STANDING:
            return f"the gait does not say of two feet that they never left the ground since step {self.step}"
        if not 0.0 <= age <= validity:
            return f"it is {age:.0f} s old, ground is valid for {validity:.0f} s"
        if stance.gravity_in_base is None or self.stance.gravity_in_base is None:
            return "gravity is not known, so that it cannot agree with that of before"
        try:
            odometry.restore(self.odometry, self.stance)
            before = odometry.last
            pose = odometry.update(stance, standing)
        except KinematicsError as error:
            return str(error)
        assert before is not None
        moved = sorted(set(standing).difference(pose.stayed_feet))
        if moved:
            return f"{', '.join(moved)} moved, of which the gait says that it stood"
        tilted = _heights_changed(before, pose, robot)
        if tilted > HEIGHT_SIGMAS:
            return f"gravity does not agree: standing soles changed their heights by {tilted:.1f} sigma"
        seen = self.map.motion_by_texture(terrain, pose, picture)
        if seen.refused or not seen.is_whole:
            return f"the first picture: {seen.refused or 'only a part of it was found again'}"
        aside, turn = float(np.linalg.norm(seen.motion[:2])), abs(float(seen.motion[2]))
        if aside > MOST_ASIDE_M or turn > MOST_TURN_RAD:
            return f"the first picture lies {1e3 * aside:.0f} mm and {np.degrees(turn):.1f} degrees beside the joints'"
        return self._contradicted(terrain, pose, time)

    def _contradicted(self, terrain: TerrainGrid, pose: OdometryPose, time: float) -> str:
        """Reason why the heights of a scan do not fit the map; empty if they do."""
        view = self.map.view(terrain, pose, time=time)
        known = np.isfinite(terrain.elevation)
        x, y = (axis[known] for axis in np.meshgrid(*terrain.geometry.centres()))
        iy, ix = view.geometry.indices(x, y)
        inside = view.geometry.contains(iy, ix)
        off = np.abs(view.elevation[iy[inside], ix[inside]] - terrain.elevation[known][inside])
        variance = view.variance[iy[inside], ix[inside]] + terrain.variance[known][inside]
        shared = np.isfinite(off)
        if shared.sum() < LEAST_SHARED * known.sum() or not shared.any():
            return f"the map knows {shared.sum()} of the {known.sum()} cells of the first scan"
        wrong = float(np.mean(off[shared] > SCAN_M + SCAN_SIGMAS * np.sqrt(variance[shared])))
        return f"the first scan contradicts {100 * wrong:.0f} % of its ground" if wrong > MOST_CONTRADICTING else ""


def _heights_changed(before: OdometryPose, now: OdometryPose, robot: RobotModel) -> float:
    """Largest change of the height of one standing sole above another, along gravity [sigmas]."""
    legs, noise = now.stayed_feet, robot.noise
    soles, variances = [], np.zeros(len(legs))
    for pose in (before.pose, now.pose):
        soles.append(transform_points(pose.transform_base_to_footprint, pose.state.soles_in_base(legs)))
        variances += pose.up_in_base @ sole_covariances(pose.state, legs, noise) @ pose.up_in_base
    change = soles[1][:, 2] - soles[0][:, 2]
    apart = np.linalg.norm(soles[1][:, None, :2] - soles[1][None, :, :2], axis=2)
    variance: Float = variances[:, None] + variances[None, :] + 2.0 * (noise.imu_sigma * apart) ** 2
    return float((np.abs(change[:, None] - change[None, :]) / np.sqrt(variance)).max())


def _odometry(fields: Fields, robot: RobotModel) -> OdometryState:
    feet = fields.sub("footholds")
    legs = tuple(map(str, feet.sequence("legs")))
    for leg in legs:
        robot.tree.leg(leg)
    n = len(legs)
    shapes: dict[str, tuple[int, ...]] = {
        "positions": (n, 4),
        "covariance": (4 * n, 4 * n),
        "with_footprint": (4, 4 * n),
        "of_footprint": (4, 4),
    }
    return OdometryState(
        step=fields.integer("step", 0),
        transform_footprint_to_odom=fields.array("transform_footprint_to_odom", (4, 4)),
        footholds=Footholds(legs, **{name: feet.array(name, shape) for name, shape in shapes.items()}),
        first_tilt=fields.array("first_tilt", (6, 6)),
    )
