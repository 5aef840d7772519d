"""Parts of messages (stance, transform, obstacle, ground patch), and checks shared by all messages."""

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
# Largest number of cells of a grid; the default map has 44,800.
MAXIMUM_CELLS = 4_000_000


def set_fields(message: Any, **values: Any) -> None:
    """Set fields of a frozen dataclass in its `__post_init__`."""
    for name, value in values.items():
        object.__setattr__(message, name, value)


def frozen(array: Array) -> Array:
    """Return a read-only, aligned, C-contiguous array: `array` itself if it is one, otherwise a copy."""
    is_frozen = array.flags.c_contiguous and array.flags.aligned and not array.flags.writeable
    result = array if is_frozen else np.array(array, order="C")
    result.setflags(write=False)
    return result


def checked_shape(shape: Sequence[int], what: str) -> tuple[int, int]:
    """Check the shape of a grid, and return it as (ny, nx).

    Raises:
        MessageError: the shape does not have two dimensions, or has no cells or too many.
    """
    if len(shape) != 2 or 0 in shape or shape[0] * shape[1] > MAXIMUM_CELLS:
        cells = f"{' x '.join(map(str, shape))} cells" if shape else "a single number"
        raise MessageError(f"{what} of {cells}; allowed: (ny, nx) with 1 to {MAXIMUM_CELLS} cells")
    return int(shape[0]), int(shape[1])


def checked_origin(origin: Sequence[float]) -> tuple[float, float]:
    """Check the origin of a grid, and return it as (x, y).

    Raises:
        MessageError: the origin is not two finite numbers.
    """
    if len(origin) != 2:
        raise MessageError(f"origin has {len(origin)} numbers; allowed: 2, x and y")
    return finite(origin[0], "origin x"), finite(origin[1], "origin y")


def finite(value: float, what: str) -> float:
    """Check that a value is a finite number, and return it as float.

    Raises:
        MessageError: the value is not a finite number.
    """
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise MessageError(f"{what} is {value!r}; a number is needed") from error
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise MessageError(f"{what} is {number}; a finite number is needed")
    return number


def checked_array(array: npt.ArrayLike, shape: tuple[int | None, ...], what: str) -> Float:
    """Return a read-only float64 copy of an array of finite numbers; None in `shape` = any length along that axis.

    Raises:
        MessageError: the array has another shape, or a value is not a finite number.
    """
    try:
        copy = np.array(array, dtype=np.float64)
    except (OverflowError, TypeError, ValueError) as error:
        raise MessageError(f"{what} is not an array of numbers: {error}") from error
    if copy.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, copy.shape, strict=True)):
        wanted = ", ".join("n" if n is None else str(n) for n in shape)
        raise MessageError(f"{what} has shape {copy.shape}; allowed: ({wanted})")
    if not np.isfinite(copy).all():
        raise MessageError(f"{what} contains NaN or infinity; finite numbers are needed")
    copy.setflags(write=False)
    return copy


def _determinant(m: Float) -> float:
    """Compute the determinant of a 3 x 3 matrix; faster than `numpy.linalg.det` for a single matrix."""
    (a, b, c), (d, e, f), (g, h, i) = m.tolist()
    return float(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))


@dataclass(frozen=True, slots=True, kw_only=True)
class StanceMessage:
    """Posture of the robot at a stance pause.

    Attributes:
        joint_positions: position of each joint by name [rad], read-only.
        support_feet: names of the legs that carry weight.
        gravity_in_base: direction of gravity in `base_link`, pointing down, of a length within
            `typestore.GRAVITY_LENGTH`; None if unknown.
    """

    joint_positions: Mapping[str, float]
    support_feet: tuple[str, ...]
    gravity_in_base: Point | None = None

    def __post_init__(self) -> None:
        """Copy and check the fields."""
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
        source_frame: name of the source frame, such as `base_link`.
        destination_frame: name of the destination frame, such as `base_footprint`.
        matrix: (4, 4) float64 matrix of a rotation and a translation [m], read-only.
        covariance: (6, 6) float64 covariance of x, y, z [m], roll, pitch and yaw [rad], read-only; None if unknown.
    """

    source_frame: str
    destination_frame: str
    matrix: Float
    covariance: Float | None = None

    def __post_init__(self) -> None:
        """Copy and check the fields."""
        name = f"transform_{self.source_frame}_to_{self.destination_frame}"
        matrix = checked_array(self.matrix, (4, 4), name)
        rotation = matrix[:3, :3]
        if not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
            raise MessageError(f"{name} has the last row {matrix[3].tolist()}; allowed: [0, 0, 0, 1]")
        # 1e-6 is far above rounding errors and far below any relevant angle (1 um at 1 m).
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
        outline: (n, 2) float64 corners of the horizontal outline, not closed, read-only [m].
        height: height above the surroundings, negative for a hole [m].
        position: (x, y, z) of the centre [m]; z is that of the top, or of the bottom of a hole.
        sigma: standard deviation of the height [m].
        hazard: union of the hazard flags of the obstacle's cells, 0 ... 65535.
    """

    outline: Float
    height: float
    position: Point
    sigma: float
    hazard: int

    def __post_init__(self) -> None:
        """Copy and check the fields."""
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
        outline: (n, 2) float64 corners, 3 to 64, not closed, read-only [m].
        height: z of the ground in the frame of the message that contains the patch [m].
        sigma: standard deviation of the height [m].
    """

    outline: Float
    height: float
    sigma: float

    def __post_init__(self) -> None:
        """Copy and check the fields."""
        outline = checked_array(self.outline, (None, 2), "outline of known ground")
        if len(outline) < 3:
            raise MessageError(f"outline of known ground has {len(outline)} corners; at least 3 are needed")
        check_value(GROUND_PATCH, "outline", outline)
        height, sigma = finite(self.height, "height of known ground"), finite(self.sigma, "sigma of known ground")
        check_value(GROUND_PATCH, "sigma", sigma)
        set_fields(self, outline=outline, height=height, sigma=sigma)


def texts(values: Sequence[str], what: str) -> tuple[str, ...]:
    """Return values as a tuple of strings.

    Raises:
        MessageError: `values` is a single string instead of a list.
    """
    if isinstance(values, str):
        raise MessageError(f"{what} is the string {values!r}; a list of strings is needed")
    return tuple(str(value) for value in values)
