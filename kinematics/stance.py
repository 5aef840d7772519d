"""Stance: joint positions, supporting feet and, if known, the direction of gravity."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from kinematics.exceptions import StanceError

FIELDS = ("joint_positions", "support_feet", "gravity_in_base")


@dataclass(frozen=True, slots=True)
class Stance:
    """State of the robot at a pause, as reported by the gait controller.

    Attributes:
        joint_positions: joint name -> position [rad], read-only.
        support_feet: names of the legs whose soles carry the body, without repetition.
        gravity_in_base: direction of gravity in `base_link`, pointing down ((0, 0, -1) when level), any length; None if
            unknown.

    Raises:
        StanceError: a value has the wrong type or is not finite, a foot is named twice, or gravity does not have three
            components or does not point down (its z is 0 or more); the message names the field.
    """

    joint_positions: Mapping[str, float]
    support_feet: tuple[str, ...]
    gravity_in_base: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "joint_positions", _checked_joints(self.joint_positions))
        object.__setattr__(self, "support_feet", _checked_feet(self.support_feet))
        if self.gravity_in_base is not None:
            object.__setattr__(self, "gravity_in_base", checked_gravity(self.gravity_in_base))

    def __reduce__(self) -> tuple[object, ...]:
        """Support pickling: a mapping proxy cannot be pickled, so it is replaced by a dict."""
        return type(self), (dict(self.joint_positions), self.support_feet, self.gravity_in_base)

    @classmethod
    def from_dict(cls, mapping: Mapping[str, object], field: str = "stance") -> Stance:
        """Create a stance from its JSON form in scan.json and session.json.

        Args:
            mapping: `{joint_positions: {name: rad}, support_feet: [leg names], gravity_in_base: [x, y, z] or
                null}`.
            field: name of the mapping, for messages.

        Raises:
            StanceError: `mapping` is not a mapping, or a field is missing, unknown or invalid; the message names the
                field.
        """
        if not isinstance(mapping, Mapping):
            raise StanceError(f"{field}: {mapping!r} is not an object with the fields {', '.join(FIELDS)}")
        for key in ("joint_positions", "support_feet"):
            if key not in mapping:
                raise StanceError(f"{field}.{key} is missing; a stance has the fields {', '.join(FIELDS)}")
        for key in mapping:
            if key not in FIELDS:
                raise StanceError(f"{field}.{key}: unknown field; a stance has the fields {', '.join(FIELDS)}")
        try:
            return cls(
                mapping["joint_positions"],  # type: ignore[arg-type]
                mapping["support_feet"],  # type: ignore[arg-type]
                mapping.get("gravity_in_base"),  # type: ignore[arg-type]
            )
        except StanceError as error:
            raise StanceError(f"{field}.{error}") from None

    def to_dict(self) -> dict[str, object]:
        """Convert the stance to its JSON form; inverse of `from_dict`."""
        return {
            "joint_positions": dict(self.joint_positions),
            "support_feet": list(self.support_feet),
            "gravity_in_base": None if self.gravity_in_base is None else list(self.gravity_in_base),
        }


def _number(value: object, field: str) -> float:
    if isinstance(value, bool) or not hasattr(value, "__float__"):
        raise StanceError(f"{field}: {value!r} is not a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise StanceError(f"{field}: {number} is not finite")
    return number


def _checked_joints(joints: object) -> Mapping[str, float]:
    if not isinstance(joints, Mapping):
        raise StanceError(f"joint_positions: {joints!r} is not a mapping from joint name to position in rad")
    for name in joints:
        if not isinstance(name, str):
            raise StanceError(f"joint_positions: {name!r} is not a joint name")
    return MappingProxyType({name: _number(value, f"joint_positions.{name}") for name, value in joints.items()})


def _checked_feet(feet: object) -> tuple[str, ...]:
    if isinstance(feet, str) or not isinstance(feet, Iterable):
        raise StanceError(f"support_feet: {feet!r} is not a list of leg names")
    names = tuple(feet)
    for name in names:
        if not isinstance(name, str):
            raise StanceError(f"support_feet: {name!r} is not a leg name")
        if names.count(name) > 1:
            raise StanceError(f"support_feet: {name!r} is named {names.count(name)} times; name each foot once")
    return names


def checked_gravity(gravity: object) -> tuple[float, float, float]:
    """Check a direction of gravity in `base_link`, and return it as a tuple.

    Raises:
        StanceError: the direction is not three finite numbers, or does not point down.
    """
    if isinstance(gravity, str) or not isinstance(gravity, Iterable):
        raise StanceError(f"gravity_in_base: {gravity!r} is not a list of three numbers")
    values = [_number(value, "gravity_in_base") for value in gravity]
    if len(values) != 3:
        raise StanceError(f"gravity_in_base: {len(values)} numbers given; three are needed")
    if values[2] >= 0.0:
        raise StanceError(
            f"gravity_in_base: z is {values[2]:g}, but gravity points down (z < 0, (0, 0, -1) when level); "
            "an accelerometer at rest reads the negative: change all three signs"
        )
    return (values[0], values[1], values[2])
