"""The summary of a fused map: three layers in small numbers, as a message and as its CDR payload."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from transport.arrays import Array
from transport.codec import decode, encode, make_header, make_time, read_time
from transport.exceptions import MessageError, VersionError
from transport.keys import check_name
from transport.shuffle import compress, decompress
from transport.submessages import finite
from transport.terrain_message import MAXIMUM_CELLS, MAXIMUM_IDENTITY
from transport.typestore import SUMMARY, message_class

VERSION_MAJOR, VERSION_MINOR = 1, 0
# [mm] In `heights`: not known.
UNKNOWN_HEIGHT = -32768
# Dtype of each layer on the wire, little endian.
LAYERS: Mapping[str, np.dtype[Any]] = {
    "heights": np.dtype("<i2"),
    "hazard": np.dtype("<u2"),
    "traversability": np.dtype("u1"),
}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SummaryMessage:
    """The fused map made small: heights, flags and traversability of every cell.

    Attributes:
        robot: instance name.
        sequence: of the map that it is made of.
        step: number of the stance pause.
        stamp, scan_end: [ns] since the epoch, as of the map.
        valid_for: [s] after `scan_end`; may be infinite.
        valid_pauses: pauses after `step` for which it may be used.
        resolution: [m] edge of a cell.
        origin: [m] (x, y) of the corner of cell (0, 0) in `frame_id`.
        heights: (ny, nx) int16 [mm], `UNKNOWN_HEIGHT` where not known.
        hazard: (ny, nx) uint16 flags.
        traversability: (ny, nx) uint8 [1/255], 0 never.
        run, epoch: identity of the node's run and of the walk; empty when it tells none.
        scan_end_clock: end of the scan by a clock of the node that never steps [s]; None when it tells none.
        provisional, withdrawn: as of the map.
        frame_id: frame of the grid.
        version: (major, minor) of the message.
    """

    # Judged as grids are; of this kind, not of the map's.
    extent: ClassVar[str] = "summary"

    robot: str
    sequence: int
    step: int
    stamp: int
    scan_end: int
    valid_for: float
    valid_pauses: int
    resolution: float
    origin: tuple[float, float]
    heights: Array
    hazard: Array
    traversability: Array
    run: str = ""
    epoch: str = ""
    scan_end_clock: float | None = None
    provisional: bool = False
    withdrawn: bool = False
    frame_id: str = "base_footprint"
    version: tuple[int, int] = (VERSION_MAJOR, VERSION_MINOR)

    def __post_init__(self) -> None:
        """Check what others rely on, and make the arrays read-only."""
        check_name(self.robot)
        shape = self.heights.shape
        if len(shape) != 2 or 0 in shape or shape[0] * shape[1] > MAXIMUM_CELLS:
            raise MessageError(f"summary has shape {shape}; allowed: (ny, nx) with 1 to {MAXIMUM_CELLS} cells")
        for name, dtype in LAYERS.items():
            array = getattr(self, name)
            if array.shape != shape or array.dtype != dtype:
                raise MessageError(
                    f"layer {name!r} of a summary is {array.dtype} {array.shape}; allowed: {dtype} {shape}"
                )
            checked = array if not array.flags.writeable and array.flags.c_contiguous else np.array(array, order="C")
            checked.setflags(write=False)
            object.__setattr__(self, name, checked)
        finite(self.origin[0], "origin x")
        finite(self.origin[1], "origin y")
        if not finite(self.resolution, "resolution") > 0:
            raise MessageError(f"resolution is {self.resolution} m; allowed: above 0")
        if math.isnan(self.valid_for) or self.valid_for < 0:
            raise MessageError(f"valid_for is {self.valid_for} s; allowed: 0 or more")
        if self.scan_end_clock is not None:
            finite(self.scan_end_clock, "scan_end_clock")
        if max(len(self.run), len(self.epoch)) > MAXIMUM_IDENTITY:
            raise MessageError(f"run or epoch is longer than {MAXIMUM_IDENTITY} characters")

    @property
    def shape(self) -> tuple[int, int]:
        """(ny, nx)."""
        ny, nx = self.heights.shape
        return ny, nx


def encode_summary(summary: SummaryMessage) -> bytearray:
    """The CDR payload of a summary, a guara_msgs/TerrainSummary.

    Raises:
        MessageError: a field does not fit its ROS 2 type.
    """
    ny, nx = summary.shape
    packed = {
        name: np.frombuffer(compress(getattr(summary, name).tobytes(), dtype.itemsize), np.uint8)
        for name, dtype in LAYERS.items()
    }
    message = message_class(SUMMARY)(
        header=make_header(summary.stamp, summary.frame_id),
        version_major=summary.version[0],
        version_minor=summary.version[1],
        robot=summary.robot,
        run=summary.run,
        epoch=summary.epoch,
        sequence=summary.sequence,
        step=summary.step,
        scan_end=make_time(summary.scan_end),
        scan_end_clock=math.nan if summary.scan_end_clock is None else summary.scan_end_clock,
        valid_for=float(summary.valid_for),
        valid_pauses=summary.valid_pauses,
        provisional=summary.provisional,
        withdrawn=summary.withdrawn,
        resolution=summary.resolution,
        origin_x=summary.origin[0],
        origin_y=summary.origin[1],
        nx=nx,
        ny=ny,
        **packed,
    )
    return encode(message)


def decode_summary(payload: bytes | bytearray | memoryview) -> SummaryMessage:
    """A summary from its CDR payload.

    Raises:
        VersionError: another major version.
        MessageError: the payload is damaged, or a length or number is not what the message allows.
    """
    message = decode(payload, SUMMARY)
    if message.version_major != VERSION_MAJOR:
        raise VersionError(
            f"summary of version {message.version_major}.{message.version_minor}; this package speaks version "
            f"{VERSION_MAJOR}: install the node's version here, or this one on the node"
        )
    shape = (int(message.ny), int(message.nx))
    if 0 in shape or shape[0] * shape[1] > MAXIMUM_CELLS:
        raise MessageError(f"summary of {shape[0]} x {shape[1]} cells; allowed: 1 to {MAXIMUM_CELLS} cells")
    try:
        return SummaryMessage(
            robot=message.robot,
            sequence=message.sequence,
            step=message.step,
            stamp=read_time(message.header.stamp),
            scan_end=read_time(message.scan_end),
            valid_for=message.valid_for,
            valid_pauses=message.valid_pauses,
            resolution=message.resolution,
            origin=(message.origin_x, message.origin_y),
            run=message.run,
            epoch=message.epoch,
            scan_end_clock=None if math.isnan(message.scan_end_clock) else message.scan_end_clock,
            provisional=bool(message.provisional),
            withdrawn=bool(message.withdrawn),
            frame_id=message.header.frame_id,
            version=(message.version_major, message.version_minor),
            **{name: _unpack(getattr(message, name), name, dtype, shape) for name, dtype in LAYERS.items()},
        )
    except MessageError:
        raise
    except (ValueError, OverflowError) as error:
        raise MessageError(f"summary refused: {error}") from error


def _unpack(packed: Array, name: str, dtype: np.dtype[Any], shape: tuple[int, int]) -> Array:
    size = shape[0] * shape[1] * dtype.itemsize
    plain = decompress(packed.tobytes(), dtype.itemsize, maximum=size)
    if len(plain) != size:
        raise MessageError(f"layer {name!r} of a summary has {len(plain)} bytes; {size} are ny * nx values")
    return np.frombuffer(plain, dtype).reshape(shape)
