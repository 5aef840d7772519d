"""Stream of stances from the gait controller: batch message and its CDR payload."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from transport.arrays import Float
from transport.exceptions import MessageError
from transport.keys import check_name
from transport.messages.codec import decode, encode, from_ros, to_ros
from transport.messages.quaternions import Quaternion, matrix_from_quaternion
from transport.messages.submessages import checked_array, set_fields, texts
from transport.messages.typestore import GRAVITY_LENGTH, STANCE_STREAM, check_value

# Largest number of samples in a message: one second at 1 kHz.
MAXIMUM_SAMPLES = 1000
# Largest payload [bytes]. One second at 1 kHz of sixteen joints, four legs and an IMU takes 190 kB.
MAXIMUM_BATCH = 4 * 1024 * 1024
# Epoch of samples whose source does not know the walk; they belong to the current walk.
ANY_WALK = "*"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StanceStream:
    """Batch of n consecutive stances; all arrays are read-only.

    Attributes:
        robot: instance name.
        stamp: time of the first sample, on the clock that stamps the pauses [ns since the Unix epoch].
        sequence: number of the batch; a gap in the numbers means that a batch was lost.
        joint_names: names of the j joints.
        legs: names of the l legs.
        times: (n,) times of the samples after `stamp`, strictly ascending from 0 [s].
        joint_positions: (n, j) positions [rad].
        supports: (n, l) True if the leg carries weight.
        gravity_in_base: (n, 3) direction of gravity in `base_link`, pointing down; None if not measured.
        angular_velocity: (n, 3) angular velocity of the body in `base_link` [rad/s]; None if not measured.
        epoch: identity of the walk, as in `StancePause`, or `ANY_WALK`.
        frame_id: name of the body frame, `base_link`.
    """

    robot: str
    stamp: int
    sequence: int
    joint_names: tuple[str, ...]
    legs: tuple[str, ...]
    times: npt.ArrayLike
    joint_positions: npt.ArrayLike
    supports: npt.ArrayLike
    gravity_in_base: npt.ArrayLike | None = None
    angular_velocity: npt.ArrayLike | None = None
    epoch: str = ""
    frame_id: str = "base_link"

    def __post_init__(self) -> None:
        """Copy and check the fields.

        Raises:
            MessageError: a value is not allowed, or lengths of arrays do not match.
            KeyNameError: the robot's name cannot be part of a key.
        """
        check_name(self.robot)
        names, legs = texts(self.joint_names, "joint_names"), texts(self.legs, "legs")
        if not names:
            raise MessageError("joint_names is empty; allowed: 1 to 256 joints")
        for what, given in (("joint_names", names), ("legs", legs)):
            if len(set(given)) != len(given):
                raise MessageError(f"{what} contains a name twice: {', '.join(given)}")
        times = checked_array(self.times, (None,), "times")
        n = len(times)
        if not 1 <= n <= MAXIMUM_SAMPLES:
            raise MessageError(f"times has {n} entries; allowed: 1 to {MAXIMUM_SAMPLES}")
        if times[0] != 0.0 or (np.diff(times) <= 0.0).any():
            raise MessageError("times must begin with 0 and ascend: each sample must be later than the previous one")
        check_value(STANCE_STREAM, "times", times)
        joints = _rows(self.joint_positions, n, len(names), "joint_positions")
        check_value(STANCE_STREAM, "joint_positions", joints.ravel())
        supports = _rows(self.supports, n, len(legs), "supports")
        check_value(STANCE_STREAM, "supports", supports.ravel())
        gravity = _vectors(self.gravity_in_base, n, "gravity_in_base")
        if gravity is not None:
            lengths = np.linalg.norm(gravity, axis=1)
            outside = lengths[(lengths < GRAVITY_LENGTH.low) | (lengths > GRAVITY_LENGTH.high)]
            if outside.size:
                raise MessageError(f"length of gravity_in_base is {outside[0]:g}; allowed: {GRAVITY_LENGTH}")
        turning = _vectors(self.angular_velocity, n, "angular_velocity")
        if turning is not None:
            check_value(STANCE_STREAM, "angular_velocity", turning.ravel())
        carries = supports > 0.5
        carries.setflags(write=False)
        set_fields(
            self,
            joint_names=names,
            legs=legs,
            times=times,
            joint_positions=joints,
            supports=carries,
            gravity_in_base=gravity,
            angular_velocity=turning,
        )

    @property
    def stamps(self) -> npt.NDArray[np.int64]:
        """(n,) times of the samples [ns since the Unix epoch]."""
        return self.stamp + np.rint(1e9 * np.asarray(self.times)).astype(np.int64)


def _rows(values: npt.ArrayLike, rows: int, columns: int, what: str) -> Float:
    """Return values as a checked array (rows, columns); a flat array is split row by row."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 1 and array.size == rows * columns:
        array = array.reshape(rows, columns)
    return checked_array(array, (rows, columns), what)


def _vectors(values: npt.ArrayLike | None, rows: int, what: str) -> Float | None:
    """Return values as a checked array (rows, 3), or None if all are NaN: in a message, NaN means not measured."""
    if values is None:
        return None
    array = np.asarray(values, dtype=np.float64)
    return None if array.size == 3 * rows and np.isnan(array).all() else _rows(array, rows, 3, what)


def encode_stance_stream(stream: StanceStream) -> bytearray:
    """Encode a batch as CDR.

    Raises:
        MessageError: a field does not fit its ROS 2 type.
    """
    # Writers of CDR disagree on the padding after an empty list of float64, so these lists are never empty.
    nothing = np.full((len(stream.stamps), 3), np.nan)
    gravity = nothing if stream.gravity_in_base is None else stream.gravity_in_base
    turning = nothing if stream.angular_velocity is None else stream.angular_velocity
    flat = {"joint_positions": stream.joint_positions, "gravity_in_base": gravity, "angular_velocity": turning}
    supports = np.asarray(stream.supports).ravel().astype(np.uint8)
    arrays = {name: np.asarray(values, np.float64).ravel() for name, values in flat.items()}
    return encode(to_ros(STANCE_STREAM, stream, supports=supports, **arrays))


def decode_stance_stream(payload: bytes | bytearray | memoryview) -> StanceStream:
    """Decode and check the CDR payload of a guara_msgs/StanceStream.

    Raises:
        MessageError: the payload is damaged, or a value is not allowed.
    """
    if len(payload) > MAXIMUM_BATCH:
        raise MessageError(f"stance stream of {len(payload)} bytes refused; allowed: up to {MAXIMUM_BATCH} bytes")
    return from_ros(StanceStream, decode(payload, STANCE_STREAM))


def gravity_of_orientation(quaternion: Quaternion) -> tuple[float, float, float]:
    """Compute the direction of gravity in a body frame, pointing down, from the body's orientation (x, y, z, w).

    The orientation is relative to a world frame with z up.

    Raises:
        MessageError: `quaternion` is not a unit quaternion.
    """
    x, y, z = (-matrix_from_quaternion(quaternion, "orientation")[2]).tolist()
    return x, y, z
