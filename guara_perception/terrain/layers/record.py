"""Records of grids: metadata of a scan and of the map of a walk."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, TypeAlias, TypeVar

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.layers.hazard import Hazard
from kinematics import Stance, StanceError
from kinematics.arrays import FrozenArrays, read_only

Reader: TypeAlias = Callable[[object], Any]
# Read-only arrays of float64: (4, 4), (6, 6), (3,) and (4, 3).
Transform: TypeAlias = Float
Covariance: TypeAlias = Float
Point: TypeAlias = Float
Sole: TypeAlias = Float
Run: TypeAlias = tuple[int, int, int]
LIMITS = TraversabilityLimits.__slots__
R = TypeVar("R", bound="GridRecord")
# Fields in the order of the JSON object. A map copies those of POSE, except the name of the robot, from its scan. Those
# of STATED are set when a grid is recorded, sent or received.
POSE = (
    *("robot", "robot_description", "mode", "method", "calibration_hash", "calibration_verdict", "stance"),
    *("attitude_source", "attitude_sigma", "support_feet_used", "support_soles", "transform_base_to_footprint"),
    "transform_camera_to_base",
)
STATED = (
    *("rounding", "withdrawn", "epoch", "provisional", "refinement_follows", "run", "scan_end_clock"),
    *("sequence", "scan_start", "scan_end", "instance"),
)


@dataclass(frozen=True, slots=True)
class Health:
    """Verdict on a grid.

    Attributes:
        level: "ok", "degraded" or "failed".
        reasons: reasons why the level is not "ok".
    """

    level: str = "ok"
    reasons: tuple[str, ...] = ()

    @staticmethod
    def of(reasons: tuple[str, ...]) -> Health:
        """Health "degraded" if there are reasons, "ok" otherwise."""
        return Health("degraded" if reasons else "ok", reasons)


@dataclass(frozen=True, slots=True)
class Rounding:
    """Bounds of the rounding errors in a compact grid.

    Attributes:
        elevation: largest error of an elevation [m].
        variance: largest relative error of a variance. The variance before rounding was at least the grid's value
            divided by (1 + this error).
    """

    elevation: float = 0.0
    variance: float = 0.0


def plain(value: object) -> object:
    """Convert the value of a field to plain JSON values."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Stance):
        return value.to_dict()
    if isinstance(value, Health | Rounding):
        value = asdict(value)
    if isinstance(value, Mapping):
        return {name: plain(entry) for name, entry in value.items()}
    return [plain(entry) for entry in value] if isinstance(value, tuple | list) else value


def _is(*kinds: type) -> Reader:
    def read(value: object) -> object:
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            raise TypeError(value)
        return value

    return read


def _each(read: Reader) -> Reader:
    return lambda value: tuple(read(entry) for entry in LIST(value))


def _named(read: Reader) -> Reader:
    return lambda value: {TEXT(name): read(entry) for name, entry in OBJECT(value).items()}


def _array(*shape: int) -> Reader:
    def read(value: object) -> object:
        array = np.array(value, dtype=np.float64)
        if array.shape != shape or not np.isfinite(array).all():
            raise ValueError(value)
        return array

    return read


def _run(value: object) -> object:
    ix, first, end = map(WHOLE, LIST(value))
    return ix, first, end


def _number_or_null(value: object) -> object:
    return None if value is None else NUMBER(value)


def _health(value: object) -> Health:
    data = OBJECT(value)
    return Health(str(data.get("level", "ok")), tuple(str(reason) for reason in LIST(data.get("reasons", ()))))


def _rounding(value: object) -> Rounding:
    data = OBJECT(value)
    rounding = Rounding(NUMBER(data["elevation"]), NUMBER(data["variance"]))
    if not (0 <= rounding.elevation < math.inf and 0 <= rounding.variance < math.inf):
        raise ValueError(value)
    return rounding


def _limits(value: object) -> TraversabilityLimits:
    return TraversabilityLimits(**known_limits(OBJECT(value), TraversabilityLimits))


def known_limits(limits: Mapping[str, Any], kind: type) -> dict[str, Any]:
    """Select the limits that are fields of the class `kind`; a grid of a newer version may contain others."""
    return {entry.name: limits[entry.name] for entry in fields(kind) if entry.name in limits}


TEXT, WHOLE, FLAG, NUMBER = _is(str), _is(int), _is(bool), _is(int, float)
LIST, OBJECT = _is(list, tuple), _is(Mapping)
# Reader of each type of field, and the allowed values in words for error messages.
FORMS: Mapping[str, tuple[Reader, str]] = {
    "str | None": (TEXT, "a string"),
    "bool | None": (FLAG, "true or false"),
    "int | None": (WHOLE, "an integer"),
    "float | None": (NUMBER, "a number"),
    "tuple[str, ...] | None": (_each(TEXT), "a list of strings"),
    "tuple[int, ...] | None": (_each(WHOLE), "a list of integers"),
    "tuple[float, ...] | None": (_each(NUMBER), "a list of numbers"),
    "tuple[Run, ...] | None": (_each(_run), "a list of runs [ix, first iy, end iy]"),
    "tuple[Mapping[str, object], ...] | None": (_each(OBJECT), "a list of objects"),
    "Mapping[str, str] | None": (_named(TEXT), "an object with string values"),
    "Mapping[str, int] | None": (_named(WHOLE), "an object with integer values"),
    "Mapping[str, float] | None": (_named(NUMBER), "an object with numbers as values"),
    "Mapping[str, float | None] | None": (_named(_number_or_null), "an object with numbers or null as values"),
    "Transform | None": (_array(4, 4), "4 x 4 finite numbers"),
    "Covariance | None": (_array(6, 6), "6 x 6 finite numbers"),
    "Mapping[str, Sole] | None": (_named(_array(4, 3)), "an object whose values are 4 x 3 finite numbers"),
    "Point | None": (_array(3), "three finite numbers"),
    "Stance | None": (lambda value: Stance.from_dict(OBJECT(value)), "a stance"),
    "TraversabilityLimits | None": (_limits, f"an object of {', '.join(LIMITS)}"),
    "Health | None": (_health, "an object of level and reasons"),
    "Rounding | None": (_rounding, "an object of elevation [m] and variance, each 0 or more"),
}


def limits_to_dict(limits: TraversabilityLimits) -> dict[str, float]:
    """Limits as plain JSON values."""
    return {name: float(getattr(limits, name)) for name in LIMITS}


@dataclass(frozen=True, eq=False, kw_only=True)
class GridRecord(FrozenArrays):
    """Fields common to the records of scans and maps; an absent value is None.

    `to_json` returns the fields that have a value, and `extra`; for a record read by `from_json`, it returns all fields
    that were read, including unknown ones. docs/files.md lists the fields of a scan.

    Attributes:
        robot, robot_description: name of the robot, and its files packed by `kinematics.describe_robot`.
        mode, method: pattern of the scan, and method of stripe extraction or other source of the heights.
        calibration_hash, calibration_verdict: identity of the calibration, and its verdict.
        stance, attitude_source, support_feet_used: stance of the robot, source of its attitude, and feet from which its
            pose was computed.
        attitude_sigma: standard deviation of the vertical relative to gravity, per axis [rad].
        support_soles: (4, 3) array of each supporting sole by leg, in base_footprint: centre [m], then the rows of its
            covariance [m^2].
        transform_base_to_footprint, transform_camera_to_base: (4, 4) pose of the body and mount of the camera.
        pose_covariance: (6, 6) covariance of `transform_base_to_footprint`: x, y, z [m], rotations [rad].
        limits: traversability limits of the assessment.
        newer_limits, limit_flags: limits unknown to this version, and the flags that they set, by name.
        validity_pauses, validity_seconds: age up to which an observation may be used [pauses, s].
        coverage, known: fraction of the expected cells (of all cells in a map or a grid made from points), and of all
            cells, that are known.
        hazard_cells: number of cells by flag.
        health: verdict on the grid.
        rounding: bounds of the rounding errors of a compact encoding.
        refinement_follows: True if a finer scan follows in this pause.
        epoch: identity of the walk.
        provisional: True if the pause has not yet confirmed that the robot stood still.
        withdrawn: True if the node withdraws the grid of this step.
        run, instance, sequence: identity of the sending node's run (new at each start), instance name, and sequence
            number of the message.
        scan_start, scan_end: times of the first and last frame [ns since the Unix epoch].
        scan_end_clock: time of the last frame on the node's clock [s].
        extra: fields of other programs and versions, null fields, and known fields whose values cannot be read.
        keys: names of the fields in the order of the JSON object that was read.
    """

    ORDER: ClassVar[tuple[str, ...]] = ()

    robot: str | None = None
    robot_description: str | None = None
    mode: str | None = None
    method: str | None = None
    calibration_hash: str | None = None
    calibration_verdict: str | None = None
    stance: Stance | None = None
    attitude_source: str | None = None
    attitude_sigma: float | None = None
    support_feet_used: tuple[str, ...] | None = None
    support_soles: Mapping[str, Sole] | None = None
    transform_base_to_footprint: Transform | None = None
    transform_camera_to_base: Transform | None = None
    pose_covariance: Covariance | None = None
    limits: TraversabilityLimits | None = None
    newer_limits: Mapping[str, object] = field(default_factory=dict)
    limit_flags: Mapping[str, str] | None = None
    validity_pauses: int | None = None
    validity_seconds: float | None = None
    coverage: float | None = None
    known: float | None = None
    hazard_cells: Mapping[str, int] | None = None
    health: Health | None = None
    rounding: Rounding | None = None
    refinement_follows: bool | None = None
    epoch: str | None = None
    provisional: bool | None = None
    withdrawn: bool | None = None
    run: str | None = None
    scan_end_clock: float | None = None
    sequence: int | None = None
    scan_start: int | None = None
    scan_end: int | None = None
    instance: str | None = None
    extra: Mapping[str, object] = field(default_factory=dict)
    keys: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Make arrays and mappings read-only."""
        super().__post_init__()
        for field_name in self.__dataclass_fields__:  # quicker than `fields`
            if isinstance(value := getattr(self, field_name), Mapping):
                items = {
                    name: read_only(item) if isinstance(item, np.ndarray) else item for name, item in value.items()
                }
                object.__setattr__(self, field_name, MappingProxyType(items))

    def __reduce__(self) -> tuple[object, ...]:
        """Support pickling by way of the JSON object."""
        return type(self).from_json, (dict(self.to_json()),)

    @classmethod
    def from_json(cls: type[R], data: Mapping[str, object]) -> R:
        """Read the JSON object of any version; values that cannot be read go to `extra`, and `check` rejects them."""
        known: dict[str, object] = {}
        extra: dict[str, object] = {}
        for name, value in data.items():
            try:
                known[name] = FORMS[cls.form_of(name)][0](value)
            except (KeyError, TypeError, ValueError, OverflowError, InvalidInput, StanceError):
                extra[name] = value
        if "limits" in known:
            known["newer_limits"] = {k: v for k, v in OBJECT(data["limits"]).items() if k not in LIMITS}
        record = cls(**known, extra=extra, keys=tuple(data))  # type: ignore[arg-type]
        record.__dict__["_json"] = MappingProxyType(dict(data))
        return record

    @classmethod
    def form_of(cls, name: str) -> str:
        """Type of a field of the JSON object.

        Raises:
            KeyError: there is no such field.
        """
        return str(cls.__dataclass_fields__[name].type)

    def to_json(self) -> Mapping[str, object]:
        """JSON object, read-only: fields in the order in which they were read, others in the order of `ORDER`."""
        return self._json

    @cached_property
    def _json(self) -> Mapping[str, object]:
        found: dict[str, object] = {}
        for name in self.ORDER:
            value = getattr(self, name)
            if value is not None:
                found[name] = plain(value)
            elif name in self.extra:
                found[name] = self.extra[name]
        if self.limits is not None:
            found["limits"] = {**limits_to_dict(self.limits), **self.newer_limits}
        # The value of a field takes precedence over an unreadable one in `extra`.
        found = {**found, **{name: value for name, value in self.extra.items() if name not in found}}
        return MappingProxyType({**{name: found[name] for name in self.keys if name in found}, **found})

    def check(self, *names: str) -> None:
        """Reject unreadable values of the named fields, or of all fields; absent and null fields are accepted.

        Raises:
            InvalidInput: a value could not be read.
        """
        for name in names or self.ORDER:
            if getattr(self, name, None) is None and (value := self.extra.get(name)) is not None:
                raise InvalidInput(
                    f"the grid's metadata has {name} = {value!r}; allowed: {FORMS[self.form_of(name)][1]}"
                )

    @property
    def required_limits(self) -> TraversabilityLimits:
        """Traversability limits of the assessment that are known to this version.

        Raises:
            InvalidInput: the limits are absent, incomplete or invalid.
        """
        if self.limits is None:
            raise InvalidInput(
                f"the grid's metadata has limits = {self.extra.get('limits')!r}; this query needs the limits "
                f"{', '.join(LIMITS)}; grids made by process_scan, TerrainMap or assess_terrain have them"
            )
        return self.limits

    def other_limits(self) -> dict[str, tuple[Hazard, float]]:
        """Limits of a newer version by name: flag set by the limit, and its value (NaN if it is not a number).

        A newer limit has no flag of its own: it sets the existing flag that `limit_flags` names, and a cell with this
        flag is a hazard like any other.

        Raises:
            InvalidInput: `limit_flags` cannot be read.
        """
        self.check("limit_flags")
        return {
            name: (Hazard[flag], limit if isinstance(limit := self.newer_limits.get(name), int | float) else math.nan)
            for name, flag in (self.limit_flags or {}).items()
            if name not in LIMITS and flag in Hazard.__members__
        }

    @property
    def checked_attitude_sigma(self) -> float:
        """Standard deviation of the vertical, 0 if unknown [rad].

        Raises:
            InvalidInput: the value cannot be read, is negative, or is not finite.
        """
        self.check("attitude_sigma")
        sigma = self.attitude_sigma or 0.0
        if not 0.0 <= sigma < math.inf:
            raise InvalidInput(f"the grid's metadata has attitude_sigma = {sigma!r}; allowed: finite, 0 or more [rad]")
        return sigma

    @property
    def checked_rounding(self) -> Rounding:
        """Rounding of the grid, zero if it was not rounded.

        Raises:
            InvalidInput: the value cannot be read.
        """
        self.check("rounding")
        return self.rounding or Rounding()


@dataclass(frozen=True, eq=False, kw_only=True)
class ScanRecord(GridRecord):
    """Record of a scan.

    Attributes:
        laser_origin: (3,) point of the mirror axis nearest to the camera, in base_footprint [m].
        stripes_planned, stripes_used: numbers of stripes.
        stripes_missing: indices of the stripes that were never added.
        frames_bad: reason why the frame was not used, by stripe index.
        off_pictures_unused: mismatch of the laser-on and laser-off images, by stripe index. After a change of the
            ambient light, the laser-off image may have been used all the same.
        points, points_used: number of image columns by status, and number of those used. In a grid made from points or
            a range image, `points_used` counts points or pixels.
        coverage_regions: coverage of each ninth of the area, by names such as "far left".
        seconds: computing time by stage [s].
        lost_cells: unscanned or occluded cells that may have been visible in a lost frame, as runs (ix, first iy,
            end iy), end exclusive.
        dark_flashes: number of dark flashes with a usable frame; None for a sweep without dark flashes.
    """

    ORDER: ClassVar[tuple[str, ...]] = (
        *POSE,
        *("laser_origin", "pose_covariance", "limits", "limit_flags", "validity_pauses", "validity_seconds"),
        *("stripes_planned", "stripes_used", "stripes_missing", "frames_bad", "off_pictures_unused"),
        *("points", "points_used", "coverage", "coverage_regions", "known", "hazard_cells", "health", "seconds"),
        *("lost_cells", "dark_flashes", *STATED),
    )

    laser_origin: Point | None = None
    stripes_planned: int | None = None
    stripes_used: int | None = None
    stripes_missing: tuple[int, ...] | None = None
    frames_bad: Mapping[str, str] | None = None
    off_pictures_unused: Mapping[str, str] | None = None
    points: Mapping[str, int] | None = None
    points_used: int | None = None
    coverage_regions: Mapping[str, float | None] | None = None
    seconds: Mapping[str, float] | None = None
    lost_cells: tuple[Run, ...] | None = None
    dark_flashes: int | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class MapRecord(GridRecord):
    """Record of the map of a walk.

    Attributes:
        transform_footprint_to_odom, odometry_covariance: pose (4, 4) of this pause and its covariance (6, 6).
        scans: number of fused scans.
        disagreeing_cells: number of heights of the last scan that disagreed with the map.
        support_residuals: height of each sole above the map [m], by leg; None if too little of the map is known under
            the sole.
        sunk_feet, slid_feet: distance by which a foot sank below the map, or slid relative to the other feet [m], by
            leg; None if no foot sank or slid.
        height_correction, height_correction_sigma: height correction of the walk and its standard deviation [m].
        known_ground: ground declared by the gait.
        sideways_correction, sideways_correction_sigma: planar correction (x, y, yaw) of the walk [m, m, rad].
        registration_refused: reason why the registration of the scan was not used.
        visual_corners: number of corners of the ground's texture that agree on a motion; None at the first pause of a
            walk, and without images.
        visual_refused: reason why the laser-off image did not correct the walk.
        foot_slips: distance by which each standing foot slid since the last pause, including a slide common to all
            feet [m], by leg; None unless camera images corrected the poses at both pauses (the first pause of a walk
            needs no correction).
        slipped_feet, odometry_residual, restarts: slipped feet, residual and restarts reported by leg odometry.
    """

    ORDER: ClassVar[tuple[str, ...]] = (
        *("robot_description", *POSE[2:], "pose_covariance", "robot", "limits", "limit_flags"),
        *("validity_pauses", "validity_seconds", "transform_footprint_to_odom", "odometry_covariance", "scans"),
        *("disagreeing_cells", "support_residuals", "height_correction", "height_correction_sigma", "known_ground"),
        *("coverage", "known", "hazard_cells", "health", "sideways_correction", "sideways_correction_sigma"),
        *("registration_refused", "visual_corners", "visual_refused", "foot_slips", "sunk_feet", "slid_feet"),
        *("slipped_feet", "odometry_residual", "restarts", *STATED),
    )

    transform_footprint_to_odom: Transform | None = None
    odometry_covariance: Covariance | None = None
    scans: int | None = None
    disagreeing_cells: int | None = None
    support_residuals: Mapping[str, float | None] | None = None
    height_correction: float | None = None
    height_correction_sigma: float | None = None
    known_ground: tuple[Mapping[str, object], ...] | None = None
    sideways_correction: tuple[float, ...] | None = None
    sideways_correction_sigma: tuple[float, ...] | None = None
    registration_refused: str | None = None
    visual_corners: int | None = None
    visual_refused: str | None = None
    foot_slips: Mapping[str, float] | None = None
    sunk_feet: Mapping[str, float] | None = None
    slid_feet: Mapping[str, float] | None = None
    slipped_feet: tuple[str, ...] | None = None
    odometry_residual: float | None = None
    restarts: tuple[str, ...] | None = None


RECORDS: Mapping[str, type[ScanRecord] | type[MapRecord]] = {"footprint": ScanRecord, "map": MapRecord}
