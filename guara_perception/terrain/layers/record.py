"""What a grid says of itself: the record of a scan, and that of the map of a walk."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from types import MappingProxyType
from typing import ClassVar, TypeAlias, TypeVar

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import TraversabilityLimits, limits_to_dict
from guara_perception.terrain.layers.hazard import Hazard
from kinematics import Stance, StanceError
from kinematics.arrays import read_only

R = TypeVar("R", bound="GridRecord")
Reader: TypeAlias = Callable[[object], object]
# Arrays of float64, read-only: (4, 4), (6, 6) and (3,).
Transform: TypeAlias = Float
Covariance: TypeAlias = Float
Point: TypeAlias = Float
Run: TypeAlias = tuple[int, int, int]
LIMITS = TraversabilityLimits.__slots__
# Fields in the order of their JSON text: of the pose, which a map takes from its scan, and of the node and its message.
POSE = (
    *("robot", "robot_description", "mode", "method", "calibration_hash", "calibration_verdict", "stance"),
    *("attitude_source", "support_feet_used", "transform_base_to_footprint", "transform_camera_to_base"),
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
        reasons: why it is not ok, each a sentence.
    """

    level: str = "ok"
    reasons: tuple[str, ...] = ()

    def to_json(self) -> dict[str, object]:
        """The JSON object."""
        return {"level": self.level, "reasons": list(self.reasons)}

    @staticmethod
    def of(reasons: tuple[str, ...]) -> Health:
        """Degraded where there are reasons, ok otherwise."""
        return Health("degraded" if reasons else "ok", reasons)


@dataclass(frozen=True, slots=True)
class Rounding:
    """How far the layers that are not rounded to one safe side may be from what was computed.

    Attributes:
        elevation: largest error of an elevation [m].
        variance: the computed variance is at least that of the grid divided by 1 + this.
    """

    elevation: float = 0.0
    variance: float = 0.0


EXACT = Rounding()


@dataclass(frozen=True, eq=False, kw_only=True)
class GridRecord:
    """What a scan and a map both say; None where it is not said.

    `to_json` gives docs/files.md's fields, and what came in by `from_json` goes out as it came, unknown fields too.

    Attributes:
        robot, robot_description: name of the robot, and its files as `kinematics.describe_robot` packs them.
        mode, method: pattern of the scan, and method of finding stripes.
        calibration_hash, calibration_verdict: which calibration, and its verdict.
        stance, attitude_source, support_feet_used: how the robot stood, and what its pose was computed from.
        transform_base_to_footprint, transform_camera_to_base: (4, 4) each.
        pose_covariance: (6, 6) of the pose in the footprint.
        limits: limits by which cells were judged.
        newer_limits, limit_flags: limits that this version does not know, and the flags that they set, by name.
        validity_pauses, validity_seconds: how long a look may be used.
        coverage, known: share of the expected cells, and of all cells, that are known.
        hazard_cells: number of cells by flag.
        health: verdict on the grid.
        rounding: by how much a compact encoding rounded it.
        refinement_follows: a finer scan follows in this pause.
        epoch: identity of the walk.
        provisional: the pause has yet to confirm that the robot stood still.
        withdrawn: it takes another grid back.
        run, instance, sequence: run and name of the node that sent it, and number of its message.
        scan_start, scan_end: first and last frame [ns since the epoch].
        scan_end_clock: the last frame by the node's clock [s].
        extra: fields of other programs and versions, null fields, and known fields whose values cannot be read.
        keys: names of the fields in the order in which they came.
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
    support_feet_used: tuple[str, ...] | None = None
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
        """Freeze arrays and mappings."""
        for entry in fields(self):
            value = getattr(self, entry.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, entry.name, read_only(value))
            elif isinstance(value, Mapping):
                object.__setattr__(self, entry.name, MappingProxyType(dict(value)))

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle support, by the JSON form."""
        return type(self).from_json, (dict(self.to_json()),)

    @classmethod
    def from_json(cls: type[R], data: Mapping[str, object]) -> R:
        """The record of a JSON object, of any version: a value that cannot be read is refused when it is asked for."""
        known: dict[str, object] = {}
        extra: dict[str, object] = {}
        for name, value in data.items():
            try:
                known[name] = FORMS[cls.form_of(name)][0](value)
            except (KeyError, TypeError, ValueError, OverflowError, InvalidInput, StanceError):
                extra[name] = value
        if "limits" in known:
            known["newer_limits"] = _newer_limits(data["limits"])
        record = cls(**known, extra=extra, keys=tuple(data))  # type: ignore[arg-type]
        record.__dict__["_json"] = MappingProxyType(dict(data))
        return record

    @classmethod
    def form_of(cls, name: str) -> str:
        """Type of a field that is in the JSON object.

        Raises:
            KeyError: it has no such field.
        """
        return str(cls.__dataclass_fields__[name].type)

    def to_json(self) -> Mapping[str, object]:
        """The JSON object, read-only; fields in the order in which they came, further ones in that of `ORDER`."""
        return self._json

    @cached_property
    def _json(self) -> Mapping[str, object]:
        found: dict[str, object] = {}
        for name in self.ORDER:
            value = getattr(self, name)
            if value is not None:
                found[name] = _plain(value)
            elif name in self.extra:
                found[name] = self.extra[name]
        if self.limits is not None:
            found["limits"] = {**limits_to_dict(self.limits), **self.newer_limits}
        # A field that is said replaces what could not be read.
        found = {**found, **{name: value for name, value in self.extra.items() if name not in found}}
        return MappingProxyType({**{name: found[name] for name in self.keys if name in found}, **found})

    def check(self, *names: str) -> None:
        """Refuse fields whose values could not be read, all of them where none is named; what is not there passes.

        Raises:
            InvalidInput: such a field.
        """
        for name in names or self.ORDER:
            if getattr(self, name, None) is None and (said := self.extra.get(name)) is not None:
                raise InvalidInput(
                    f"the grid's metadata says {name} = {said!r}; allowed: {FORMS[self.form_of(name)][1]}"
                )

    @property
    def required_limits(self) -> TraversabilityLimits:
        """The limits by which cells were judged, those that this version knows.

        Raises:
            InvalidInput: there are none, or not all of them.
        """
        if self.limits is None:
            raise InvalidInput(
                f"the grid's metadata says limits = {self.extra.get('limits')!r}; a grid made by process_scan, "
                f"TerrainMap or assess_terrain holds {', '.join(LIMITS)} there, and is needed for this question"
            )
        return self.limits

    def other_limits(self) -> dict[str, tuple[Hazard, float]]:
        """Limits of a newer version by which the grid was judged too: name -> the flag that it sets, and its value.

        A new limit has no flag of its own, since all bits for known ground are taken: it sets the nearest one and says
        which in `limit_flags`. What it flagged is a hazard here like any other.
        """
        self.check("limit_flags")
        return {
            name: (Hazard[flag], limit if isinstance(limit := self.newer_limits.get(name), int | float) else math.nan)
            for name, flag in (self.limit_flags or {}).items()
            if name not in LIMITS and flag in Hazard.__members__
        }

    @property
    def checked_rounding(self) -> Rounding:
        """The rounding; zeros where the grid is as computed.

        Raises:
            InvalidInput: it cannot be read.
        """
        self.check("rounding")
        return self.rounding or EXACT


@dataclass(frozen=True, eq=False, kw_only=True)
class ScanRecord(GridRecord):
    """What a scan says of itself.

    Attributes:
        laser_origin: (3,) position of the laser in base_footprint [m].
        stripes_planned, stripes_used: numbers of stripes.
        stripes_missing: those that were not fired.
        frames_bad, off_pictures_unused: reasons by number of the stripe.
        points, points_used: number of image columns by status, and of those used.
        coverage_regions: coverage of each ninth of the area.
        seconds: processor time by stage [s].
        lost_cells: cells whose frame was lost, runs (ix, first iy, end iy).
    """

    ORDER: ClassVar[tuple[str, ...]] = (
        *POSE,
        *("laser_origin", "pose_covariance", "limits", "limit_flags", "validity_pauses", "validity_seconds"),
        *("stripes_planned", "stripes_used", "stripes_missing", "frames_bad", "off_pictures_unused"),
        *("points", "points_used", "coverage", "coverage_regions", "known", "hazard_cells", "health", "seconds"),
        *("lost_cells", *STATED),
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


@dataclass(frozen=True, eq=False, kw_only=True)
class MapRecord(GridRecord):
    """What the map of a walk says of itself.

    Attributes:
        transform_footprint_to_odom, odometry_covariance: (4, 4) and (6, 6), pose of this pause.
        scans: number of scans fused.
        disagreeing_cells: heights of the last scan that disagreed with the map.
        support_residuals: leg -> height of its sole over the map [m], None where the map knows too little.
        height_correction, height_correction_sigma: of the walk [m].
        known_ground: patches that were declared.
        sideways_correction, sideways_correction_sigma: (x, y, yaw) of the walk [m, m, rad].
        registration_refused: why the scan was not laid onto the map.
        slipped_feet, odometry_residual, restarts: what leg odometry found.
    """

    ORDER: ClassVar[tuple[str, ...]] = (
        *("robot_description", *POSE[2:], "pose_covariance", "robot", "limits", "limit_flags"),
        *("validity_pauses", "validity_seconds", "transform_footprint_to_odom", "odometry_covariance", "scans"),
        *("disagreeing_cells", "support_residuals", "height_correction", "height_correction_sigma", "known_ground"),
        *("coverage", "known", "hazard_cells", "health", "sideways_correction", "sideways_correction_sigma"),
        *("registration_refused", "slipped_feet", "odometry_residual", "restarts", *STATED),
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
    slipped_feet: tuple[str, ...] | None = None
    odometry_residual: float | None = None
    restarts: tuple[str, ...] | None = None


RECORDS: Mapping[str, type[ScanRecord] | type[MapRecord]] = {"footprint": ScanRecord, "map": MapRecord}


def _plain(value: object) -> object:
    """A field as JSON values."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Stance):
        return value.to_dict()
    if isinstance(value, Health):
        return value.to_json()
    if isinstance(value, Rounding):
        return {"elevation": value.elevation, "variance": value.variance}
    if isinstance(value, Mapping):
        return {name: _plain(entry) for name, entry in value.items()}
    return [_plain(entry) for entry in value] if isinstance(value, tuple | list) else value


def _is(*kinds: type) -> Reader:
    def read(value: object) -> object:
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            raise TypeError(value)
        return value

    return read


def _each(read: Reader) -> Reader:
    def read_all(value: object) -> object:
        return tuple(read(entry) for entry in _list(value))

    return read_all


def _named(read: Reader) -> Reader:
    def read_all(value: object) -> object:
        return {str(TEXT(name)): read(entry) for name, entry in _object(value).items()}

    return read_all


def _array(*shape: int) -> Reader:
    def read(value: object) -> object:
        array = np.array(value, dtype=np.float64)
        if array.shape != shape or not np.isfinite(array).all():
            raise ValueError(value)
        return array

    return read


def _list(value: object) -> Sequence[object]:
    if not isinstance(value, list | tuple):
        raise TypeError(value)
    return value


def _object(value: object) -> Mapping[str, object]:
    if not isinstance(value, Mapping):
        raise TypeError(value)
    return value


def _run(value: object) -> object:
    ix, first, end = (WHOLE(entry) for entry in _list(value))
    return ix, first, end


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(value)
    return value


def _number_or_null(value: object) -> object:
    return None if value is None else _number(value)


def _health(value: object) -> Health:
    data = _object(value)
    return Health(str(data.get("level", "ok")), tuple(str(reason) for reason in _list(data.get("reasons", ()))))


def _rounding(value: object) -> Rounding:
    data = _object(value)
    rounding = Rounding(_number(data["elevation"]), _number(data["variance"]))
    if not (0 <= rounding.elevation < math.inf and 0 <= rounding.variance < math.inf):
        raise ValueError(value)
    return rounding


def _limits(value: object) -> TraversabilityLimits:
    return TraversabilityLimits(**known_limits(_object(value), TraversabilityLimits))  # type: ignore[arg-type]


def known_limits(limits: Mapping[str, object], kind: type) -> dict[str, object]:
    """Those of the limits that a class of limits has; a grid of a newer version may hold more."""
    return {entry.name: limits[entry.name] for entry in fields(kind) if entry.name in limits}


def _newer_limits(value: object) -> dict[str, object]:
    return {name: limit for name, limit in _object(value).items() if name not in LIMITS}


TEXT, WHOLE, FLAG = _is(str), _is(int), _is(bool)
# How a field of each type is read, and what it may be.
FORMS: Mapping[str, tuple[Reader, str]] = {
    "str | None": (TEXT, "text"),
    "bool | None": (FLAG, "true and false"),
    "int | None": (WHOLE, "a whole number"),
    "float | None": (_number, "a number"),
    "tuple[str, ...] | None": (_each(TEXT), "a list of texts"),
    "tuple[int, ...] | None": (_each(WHOLE), "a list of whole numbers"),
    "tuple[float, ...] | None": (_each(_number), "a list of numbers"),
    "tuple[Run, ...] | None": (_each(_run), "a list of runs [ix, first iy, end iy]"),
    "tuple[Mapping[str, object], ...] | None": (_each(_object), "a list of objects"),
    "Mapping[str, str] | None": (_named(TEXT), "an object of texts"),
    "Mapping[str, int] | None": (_named(WHOLE), "an object of whole numbers"),
    "Mapping[str, float] | None": (_named(_number), "an object of numbers"),
    "Mapping[str, float | None] | None": (_named(_number_or_null), "an object of numbers"),
    "Transform | None": (_array(4, 4), "4 x 4 finite numbers"),
    "Covariance | None": (_array(6, 6), "6 x 6 finite numbers"),
    "Point | None": (_array(3), "three finite numbers"),
    "Stance | None": (lambda value: Stance.from_dict(_object(value)), "a stance"),
    "TraversabilityLimits | None": (_limits, f"an object of {', '.join(LIMITS)}"),
    "Health | None": (_health, "an object of level and reasons"),
    "Rounding | None": (_rounding, "an object of elevation [m] and variance, each 0 or more"),
}
