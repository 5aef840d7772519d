"""Parts of messages (stance, transform, obstacle, declared ground), and the checks that they share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from transport.arrays import Array, Float
from transport.exceptions import MessageError
from transport.messages.typestore import GROUND_PATCH, check_gravity, check_value

Point = tuple[float, float, float]

IDENTITY = np.eye(3)
# Largest grid; the default map has 44,800 cells.
MAXIMUM_CELLS = 4_000_000


def set_fields(message: Any, **values: Any) -> None:
    """Set fields of a frozen dataclass during its construction."""
    for name, value in values.items():
        object.__setattr__(message, name, value)


def frozen(array: Array) -> Array:
    """Read-only C-contiguous array: `array` itself if it is one, else a copy."""
    is_frozen = array.flags.c_contiguous and array.flags.aligned and not array.flags.writeable
    result = array if is_frozen else np.array(array, order="C")
    result.setflags(write=False)
    return result


def checked_shape(shape: Sequence[int], what: str) -> tuple[int, int]:
    """Check the shape of a grid and return it as (ny, nx).

    Raises:
        MessageError: not two dimensions, empty, or too many cells.
    """
    if len(shape) != 2 or 0 in shape or shape[0] * shape[1] > MAXIMUM_CELLS:
        cells = " x ".join(map(str, shape))
        raise MessageError(f"{what} of {cells} cells; allowed: (ny, nx) with 1 to {MAXIMUM_CELLS} cells")
    return int(shape[0]), int(shape[1])


def checked_origin(origin: Sequence[float]) -> tuple[float, float]:
    """Check an origin and return it as (x, y).

    Raises:
        MessageError: not two finite numbers.
    """
    if len(origin) != 2:
        raise MessageError(f"origin has {len(origin)} numbers; allowed: 2, x and y")
    return finite(origin[0], "origin x"), finite(origin[1], "origin y")


def finite(value: float, what: str) -> float:
    """Check a number and return it as float.

    Raises:
        MessageError: not a finite number.
    """
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise MessageError(f"{what} is {value!r}; a number is needed") from error
    if not math.isfinite(number):
        raise MessageError(f"{what} is {number}; a finite number is needed")
    return number


def checked_array(array: npt.ArrayLike, shape: tuple[int | None, ...], what: str) -> Float:
    """Read-only float64 copy of an array after checking shape and finite values; None in `shape` = any length.

    Raises:
        MessageError: another shape, or a value that is not finite.
    """
    try:
        copy = np.array(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise MessageError(f"{what} is not an array of numbers: {error}") from error
    if copy.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, copy.shape, strict=True)):
        wanted = ", ".join("n" if n is None else str(n) for n in shape)
        raise MessageError(f"{what} has shape {copy.shape}; allowed: ({wanted})")
    if not np.isfinite(copy).all():
        raise MessageError(f"{what} holds NaN or infinity; finite numbers are needed")
    copy.setflags(write=False)
    return copy


def _determinant(m: Float) -> float:
    """Determinant of a 3 x 3 matrix; written out, because it is computed for every grid received."""
    (a, b, c), (d, e, f), (g, h, i) = m.tolist()
    return float(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))


@dataclass(frozen=True, slots=True, kw_only=True)
class StanceMessage:
    """Posture of the robot at a stance pause.

    Attributes:
        joint_positions: joint name -> position [rad], read-only.
        support_feet: names of the legs that carry weight.
        gravity_in_base: direction of gravity in `base_link`, pointing down, with a length within
            `typestore.GRAVITY_LENGTH`; None if unknown.
    """

    joint_positions: Mapping[str, float]
    support_feet: tuple[str, ...]
    gravity_in_base: Point | None = None

    def __post_init__(self) -> None:
        """Copy and check."""
        joints = {str(k): finite(v, f"position of joint {k!r}") for k, v in self.joint_positions.items()}
        feet = tuple(str(foot) for foot in self.support_feet)
        set_fields(self, joint_positions=MappingProxyType(joints), support_feet=feet)
        if self.gravity_in_base is not None:
            gravity = checked_array(self.gravity_in_base, (3,), "gravity_in_base")
            object.__setattr__(self, "gravity_in_base", tuple(gravity.tolist()))
            check_gravity(self.gravity_in_base)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TransformMessage:
    """Transform between two frames: `transform_<source_frame>_to_<destination_frame>`.

    Attributes:
        source_frame: for example `base_link`.
        destination_frame: for example `base_footprint`.
        matrix: (4, 4) float64, a rotation and a translation [m], read-only.
        covariance: (6, 6) float64 in the order x, y, z, roll, pitch, yaw [m, rad], read-only; None if unknown.
    """

    source_frame: str
    destination_frame: str
    matrix: Float
    covariance: Float | None = None

    def __post_init__(self) -> None:
        """Copy and check."""
        name = f"transform_{self.source_frame}_to_{self.destination_frame}"
        matrix = checked_array(self.matrix, (4, 4), name)
        rotation = matrix[:3, :3]
        if not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
            raise MessageError(f"{name} has the last row {matrix[3].tolist()}; allowed: [0, 0, 0, 1]")
        # 1e-6 is far above rounding and far below any relevant angle (1 um at 1 m).
        error = np.abs(rotation @ rotation.T - IDENTITY).max()
        if error > 1e-6 or _determinant(rotation) < 0.0:
            raise MessageError(f"{name} does not contain a rotation in its upper left 3 x 3 part")
        object.__setattr__(self, "matrix", matrix)
        if self.covariance is not None:
            covariance = checked_array(self.covariance, (6, 6), f"covariance of {name}")
            object.__setattr__(self, "covariance", covariance)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ObstacleMessage:
    """Obstacle or hole in the terrain, in the frame of the message that contains it.

    Attributes:
        outline: (n, 2) float64, corners of the horizontal outline, not closed, read-only [m].
        height: height above its surroundings, negative for a hole [m].
        position: (x, y, z) of the centre; z is the top, or the bottom of a hole [m].
        sigma: standard deviation of the height [m].
        hazard: union of the hazard flags of its cells, 0 ... 65535.
    """

    outline: Float
    height: float
    position: Point
    sigma: float
    hazard: int

    def __post_init__(self) -> None:
        """Copy and check."""
        outline = checked_array(self.outline, (None, 2), "outline of an obstacle")
        height, sigma = finite(self.height, "height of an obstacle"), finite(self.sigma, "sigma of an obstacle")
        position = tuple(checked_array(self.position, (3,), "position of an obstacle").tolist())
        if not 0 <= int(self.hazard) < 2**16:
            raise MessageError(f"hazard of an obstacle is {self.hazard}; allowed: 0 to 65535")
        set_fields(self, outline=outline, height=height, position=position, sigma=sigma, hazard=int(self.hazard))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GroundPatch:
    """Ground declared safe by the gait controller.

    Attributes:
        outline: (n, 2) float64, at least 3 corners, not closed, read-only [m].
        height: z in the frame of the message that contains it [m].
        sigma: standard deviation of the height [m].
    """

    outline: Float
    height: float
    sigma: float

    def __post_init__(self) -> None:
        """Copy and check."""
        outline = checked_array(self.outline, (None, 2), "outline of known ground")
        if len(outline) < 3:
            raise MessageError(f"outline of known ground has {len(outline)} corners; at least 3 are needed")
        check_value(GROUND_PATCH, "outline", outline)
        height, sigma = finite(self.height, "height of known ground"), finite(self.sigma, "sigma of known ground")
        check_value(GROUND_PATCH, "sigma", sigma)
        set_fields(self, outline=outline, height=height, sigma=sigma)


def texts(values: Sequence[str], what: str) -> tuple[str, ...]:
    """Values as a tuple of strings.

    Raises:
        MessageError: a single string was given instead of a list.
    """
    if isinstance(values, str):
        raise MessageError(f"{what} is the string {values!r}; a list of strings is needed")
    return tuple(str(value) for value in values)
