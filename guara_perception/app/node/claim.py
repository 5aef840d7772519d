"""State of a walk after a pause, stored in the journal. A restarted node checks it before continuing the walk.

Joint readings alone cannot distinguish a robot that stood from one that was carried with stiff legs or turned on flat
ground. The walk therefore continues only if the gait reports which feet have not left the ground, and joints, gravity,
the first scan and its laser-off image all fit the stored state.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
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
# [byte] Largest file that is read; a journal normally has 1 to 4 MB.
LARGEST_JOURNAL = 64 * 1024 * 1024
# Identifier of the current boot; `transport.clock` restarts at every boot.
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
# Suffixes of the files of a robot folder on which a map depends.
ROBOT_FILES = {".urdf", ".srdf", ".toml"}
# Smallest number of feet that must have stood; with fewer, the motion since the claim is not known.
LEAST_STANDING = 2
# Largest offset of the first image from its pose by odometry [m, rad]; sliding feet and joint noise cause a third of
# this in two pauses.
MOST_ASIDE_M, MOST_TURN_RAD = 0.010, np.radians(1.0)
# Largest change in height of a standing sole relative to another [sigmas].
HEIGHT_SIGMAS = 4.0
# Smallest fraction of the first scan's known cells that the map must also know, and largest fraction of these shared
# cells whose heights may differ by more than SCAN_M [m] plus SCAN_SIGMAS sigmas.
LEAST_SHARED, MOST_CONTRADICTING, SCAN_SIGMAS, SCAN_M = 0.25, 0.10, 3.0, 0.005


@dataclass(frozen=True, slots=True)
class Seal:
    """Identity of robot, calibration and boot, which must be the same for a journal and the node that reads it.

    Attributes:
        instance: instance name of the robot.
        robot: digest of the robot's description files.
        calibration: hash of the calibration.
        boot: identifier of the current boot.
    """

    instance: str
    robot: str
    calibration: str
    boot: str

    @classmethod
    def of(cls, instance: str, robot: RobotModel, calibration: Calibration) -> Seal:
        """Make the seal of a node on this machine; the boot is empty if the system does not provide an identifier."""
        digest = hashlib.sha256()
        for file in sorted(path for path in robot.folder.rglob("*") if path.suffix in ROBOT_FILES):
            digest.update(file.name.encode() + b"\0" + file.read_bytes())
        boot = BOOT_ID.read_text().strip() if BOOT_ID.is_file() else ""
        return cls(instance, digest.hexdigest(), calibration.hash, boot)


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """State of a walk after a pause.

    Attributes:
        epoch: identity of the walk, given by the gait.
        step, stance: number and stance of the pause.
        time: time of the last frame of its scan on `transport.clock` [s].
        odometry, map: leg odometry and terrain map after the pause.
        restarts: reasons for the restarts of the map so far.
    """

    epoch: str
    step: int
    stance: Stance
    time: float
    odometry: OdometryState
    map: TerrainMap
    restarts: tuple[str, ...] = ()

    def write(self, stream: IO[bytes], seal: Seal) -> None:
        """Write three parts to a file: a line with format and digest of the rest, the claim as JSON, and the map."""
        claimed = {
            **dataclasses.asdict(seal),
            "epoch": self.epoch,
            "step": self.step,
            "time": self.time,
            "stance": self.stance.to_dict(),
            "odometry": dataclasses.asdict(self.odometry),
            "restarts": self.restarts,
        }
        body = io.BytesIO()
        body.write(json.dumps(claimed, default=np.ndarray.tolist).encode() + b"\n")
        self.map.write(body)
        stream.write(f"{FORMAT} {hashlib.sha256(body.getbuffer()).hexdigest()}\n".encode())
        stream.write(body.getbuffer())

    @classmethod
    def read(cls, path: Path, robot: RobotModel, seal: Seal) -> Claim:
        """Read a file written by `write`.

        Raises:
            FileFormatError: the file is damaged, too long, of another version, or written under another seal.
        """
        head, _, body = read_bounded(path, LARGEST_JOURNAL).partition(b"\n")
        kind, _, digest = head.decode(errors="replace").partition(" ")
        if kind != FORMAT:
            raise FileFormatError(f"{path}: format is {kind[:40]!r}; allowed: {FORMAT!r}")
        if hashlib.sha256(body).hexdigest() != digest:
            raise FileFormatError(f"{path}: the digest does not match; the file is truncated or damaged")
        fields = parse_json(body.partition(b"\n")[0], str(path))
        for name, value in dataclasses.asdict(seal).items():
            given = fields.text(name)
            if given != value:
                raise FileFormatError(f"{path}: {name} is {given[:40]!r}, but this node has {value[:40]!r}")
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
    ) -> tuple[str, bool]:
        """Compare the first scan after a restart with the claim.

        If stripes were not fired, for instance because the pause ended early, a misfit of image or heights does not
        reject the walk.

        Args:
            stance: stance of the scan's pause.
            terrain: grid of the scan alone.
            odometry: leg odometry of this robot before any pause; it is set to the claim and updated with this pause.
            standing: feet that have not left the ground since the pause of the claim, as reported by the gait.
            time: time of the scan's last frame on `transport.clock` [s].
            picture: laser-off image of the scan, as in `TerrainMap.update`.

        Returns:
            Reason why the scan does not fit, empty if it fits; and True if a later scan may still fit.
        """
        robot = self.map.robot
        age, validity = time - self.time, Settings.of(robot).validity_seconds
        if len(standing) < LEAST_STANDING:
            return f"the gait reports fewer than two feet that never left the ground since step {self.step}", False
        if not 0.0 <= age <= validity:
            return f"the stored walk is {age:.0f} s old, but ground is valid for only {validity:.0f} s", False
        if stance.gravity_in_base is None or self.stance.gravity_in_base is None:
            return "gravity is not known, so it cannot be compared", False
        try:
            odometry.restore(self.odometry, self.stance)
            before = odometry.last
            pose = odometry.update(stance, standing)
        except KinematicsError as error:
            return str(error), False
        assert before is not None
        moved = sorted(set(standing).difference(pose.stayed_feet))
        if moved:
            return f"{', '.join(moved)} moved, but stood according to the gait", False
        tilted = _heights_changed(before, pose, robot)
        if tilted > HEIGHT_SIGMAS:
            return f"gravity does not agree: the heights of standing soles changed by {tilted:.1f} sigma", False
        why = self._unlike(terrain, pose, time, picture)
        return why, bool(why and terrain.scan_record.stripes_missing)

    def _unlike(
        self, terrain: TerrainGrid, pose: OdometryPose, time: float, picture: GroundPicture | str | None
    ) -> str:
        """Reason why laser-off image or heights of a scan do not fit the map; empty if both fit."""
        seen = self.map.motion_by_texture(terrain, pose, picture)
        if seen.refused or not seen.is_whole:
            return f"the first image: {seen.refused or f'only a part of it was found again: {seen.part}'}"
        aside, turn = float(np.linalg.norm(seen.motion[:2])), abs(float(seen.motion[2]))
        if aside > MOST_ASIDE_M or turn > MOST_TURN_RAD:
            return f"the first image is {1e3 * aside:.0f} mm and {np.degrees(turn):.1f} degrees off its odometry pose"
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
        return (
            f"the first scan contradicts {100 * wrong:.0f} % of the shared cells" if wrong > MOST_CONTRADICTING else ""
        )


def _heights_changed(before: OdometryPose, now: OdometryPose, robot: RobotModel) -> float:
    """Largest change in height of a standing sole relative to another, along gravity [sigmas]."""
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
    if feet.has("by_slides"):
        # Journals of earlier versions lack this field.
        shapes["by_slides"] = (4, 4)
    return OdometryState(
        step=fields.integer("step", 0),
        transform_footprint_to_odom=fields.array("transform_footprint_to_odom", (4, 4)),
        footholds=Footholds(legs, **{name: feet.array(name, shape) for name, shape in shapes.items()}),
        first_tilt=fields.array("first_tilt", (6, 6)),
    )
