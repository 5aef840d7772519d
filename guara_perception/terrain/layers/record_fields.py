"""Types of the fields of records, and their JSON forms."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, TypeAlias

import numpy as np

from guara_perception.arrays import Float
from guara_perception.settings import TraversabilityLimits
from kinematics import Stance

Reader: TypeAlias = Callable[[object], Any]
# Arrays of float64, read-only: (4, 4), (6, 6), (3,) and (4, 3).
Transform: TypeAlias = Float
Covariance: TypeAlias = Float
Point: TypeAlias = Float
Sole: TypeAlias = Float
Run: TypeAlias = tuple[int, int, int]
LIMITS = TraversabilityLimits.__slots__


@dataclass(frozen=True, slots=True)
class Health:
    """Verdict on a grid.

    Attributes:
        level: "ok", "degraded" or "failed".
        reasons: reasons why it is not ok.
    """

    level: str = "ok"
    reasons: tuple[str, ...] = ()

    @staticmethod
    def of(reasons: tuple[str, ...]) -> Health:
        """Degraded if there are reasons, ok otherwise."""
        return Health("degraded" if reasons else "ok", reasons)


@dataclass(frozen=True, slots=True)
class Rounding:
    """Bounds of the rounding errors in a compact grid, for layers that are not rounded to the safe side.

    Attributes:
        elevation: largest error of an elevation [m].
        variance: largest relative error of a variance: before rounding it was at least that of the grid / (1 + this).
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
    def read_all(value: object) -> object:
        return tuple(read(entry) for entry in LIST(value))

    return read_all


def _named(read: Reader) -> Reader:
    def read_all(value: object) -> object:
        return {TEXT(name): read(entry) for name, entry in OBJECT(value).items()}

    return read_all


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
    """The limits that are fields of a class of limits; a grid of a newer version may hold others too."""
    return {entry.name: limits[entry.name] for entry in fields(kind) if entry.name in limits}


TEXT, WHOLE, FLAG, NUMBER = _is(str), _is(int), _is(bool), _is(int, float)
LIST, OBJECT = _is(list, tuple), _is(Mapping)
# Type of a field -> its reader, and the allowed values in words, for error messages.
FORMS: Mapping[str, tuple[Reader, str]] = {
    "str | None": (TEXT, "text"),
    "bool | None": (FLAG, "true and false"),
    "int | None": (WHOLE, "a whole number"),
    "float | None": (NUMBER, "a number"),
    "tuple[str, ...] | None": (_each(TEXT), "a list of texts"),
    "tuple[int, ...] | None": (_each(WHOLE), "a list of whole numbers"),
    "tuple[float, ...] | None": (_each(NUMBER), "a list of numbers"),
    "tuple[Run, ...] | None": (_each(_run), "a list of runs [ix, first iy, end iy]"),
    "tuple[Mapping[str, object], ...] | None": (_each(OBJECT), "a list of objects"),
    "Mapping[str, str] | None": (_named(TEXT), "an object of texts"),
    "Mapping[str, int] | None": (_named(WHOLE), "an object of whole numbers"),
    "Mapping[str, float] | None": (_named(NUMBER), "an object of numbers"),
    "Mapping[str, float | None] | None": (_named(_number_or_null), "an object of numbers"),
    "Transform | None": (_array(4, 4), "4 x 4 finite numbers"),
    "Covariance | None": (_array(6, 6), "6 x 6 finite numbers"),
    "Mapping[str, Sole] | None": (_named(_array(4, 3)), "an object of 4 x 3 finite numbers"),
    "Point | None": (_array(3), "three finite numbers"),
    "Stance | None": (lambda value: Stance.from_dict(OBJECT(value)), "a stance"),
    "TraversabilityLimits | None": (_limits, f"an object of {', '.join(LIMITS)}"),
    "Health | None": (_health, "an object of level and reasons"),
    "Rounding | None": (_rounding, "an object of elevation [m] and variance, each 0 or more"),
}


def limits_to_dict(limits: TraversabilityLimits) -> dict[str, float]:
    """Limits as plain JSON values."""
    return {name: float(getattr(limits, name)) for name in LIMITS}
