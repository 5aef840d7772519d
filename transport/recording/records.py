"""Records of a recorded scan: frame, stripe, flash, and the scan itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from transport.arrays import Array
from transport.exceptions import MessageError, check_choice
from transport.messages.codec import make_header
from transport.messages.submessages import StanceMessage, finite
from transport.messages.terrain_message import MODES
from transport.messages.typestore import COMPRESSED_IMAGE, IMAGE, message_class

CAMERA_FRAME = "camera_optical_frame"
COMPRESSED_FORMATS = ("jpeg", "png")

# ROS encodings of pixels by dtype and shape of a pixel.
ENCODINGS = {("uint8", ()): "mono8", ("uint16", ()): "mono16", ("uint8", (3,)): "bgr8", ("uint16", (3,)): "bgr16"}
KINDS = {name: kind for kind, name in ENCODINGS.items()}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FrameRecord:
    """Camera image, either as pixels or as the content of an image file.

    Attributes:
        pixels: (h, w) grey or (h, w, 3) BGR, uint8 or uint16, read-only; None if the image is a file.
        data: content of the image file; None if the image is given as pixels.
        format: format of the file, "jpeg" or "png"; empty for pixels.
        stamp: time of the frame [ns since the Unix epoch]; 0 = not given.
    """

    pixels: Array | None = None
    data: bytes | None = None
    format: str = ""
    stamp: int = 0

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            MessageError: both or neither of `pixels` and `data` are given, the format is unknown, or shape or dtype is
                not allowed.
        """
        if (self.pixels is None) == (self.data is None):
            raise MessageError("a frame needs either pixels or the bytes of an image file, but not both")
        if self.data is not None:
            check_choice("format of a frame", self.format, COMPRESSED_FORMATS)
        if self.pixels is not None:
            if self.pixels.ndim < 2 or _kind(self.pixels) not in ENCODINGS or self.pixels.size == 0:
                raise MessageError(
                    f"pixels of a frame are {self.pixels.dtype} of shape {self.pixels.shape}; allowed: "
                    f"uint8 or uint16, (h, w) or (h, w, 3)"
                )
            pixels = self.pixels.view()
            pixels.setflags(write=False)
            object.__setattr__(self, "pixels", pixels)


@dataclass(frozen=True, slots=True)
class FrameReference:
    """Reference to a frame in a recording.

    Attributes:
        topic: topic of the frame's message.
        stamp: stamp of the frame [ns since the Unix epoch], unique in its topic.
    """

    topic: str
    stamp: int


@dataclass(frozen=True, slots=True)
class FlashRecord:
    """Time of a stripe's flash, on the clock that stamps the stance pauses.

    Attributes:
        begin: stamp of the BEGIN message of the flash's pause [ns].
        stamp: time of the middle of the flash [ns].
        sigma: standard deviation of `stamp` [ns].
    """

    begin: int
    stamp: int
    sigma: int


@dataclass(frozen=True, slots=True, kw_only=True)
class StripeRecord:
    """Stripe of a recorded scan.

    Attributes:
        index: index in the standard pattern.
        mirror_angle: commanded mirror angle [rad].
        on: frame with the laser on; None if it was lost.
        off: frame with the laser off, which several stripes may share; None if there is none.
        stamp: time of the stripe [ns since the Unix epoch].
        dark: frame of the dark flash after the stripe; None if there was no dark flash or its frame was lost.
        is_dark_due: True if a dark flash was planned after the stripe.
        flash: time of the flash, if the joint stream was used to place the stripe; otherwise None.
    """

    index: int
    mirror_angle: float
    on: FrameReference | None
    off: FrameReference | None
    stamp: int
    dark: FrameReference | None = None
    is_dark_due: bool = False
    flash: FlashRecord | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ScanRecord:
    """Recorded scan.

    Attributes:
        robot: instance name.
        mode: "coarse" or "standard".
        stamp: time of the scan [ns since the Unix epoch].
        step: number of the stance pause.
        stance: stance at the beginning of the scan.
        calibration_hash: hash of the calibration; may be empty.
        stance_end: stance after the scan; None if it was not read.
        stripes: stripes, in the order of scanning.
        is_whole: True if the recording contains the complete scan.
    """

    robot: str
    mode: str
    stamp: int
    step: int
    stance: StanceMessage
    calibration_hash: str = ""
    stance_end: StanceMessage | None = None
    stripes: tuple[StripeRecord, ...] = ()
    is_whole: bool = True

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            MessageError: the mode is unknown, or a mirror angle is not finite.
        """
        check_choice("mode", self.mode, MODES)
        for stripe in self.stripes:
            finite(stripe.mirror_angle, f"mirror_angle of stripe {stripe.index}")


def _kind(pixels: Array) -> tuple[str, tuple[int, ...]]:
    return str(pixels.dtype), pixels.shape[2:]


def image_message(pixels: Array, encoding: str, frame_id: str, stamp: int) -> Any:
    """Make a sensor_msgs/Image message object from pixels (h, w) or (h, w, channels) in a ROS encoding."""
    # The message is little endian, even on a big-endian machine.
    pixels = np.ascontiguousarray(pixels, dtype=pixels.dtype.newbyteorder("<"))
    height, width = pixels.shape[:2]
    return message_class(IMAGE)(
        header=make_header(stamp, frame_id),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=pixels.nbytes // height,
        data=pixels.reshape(-1).view(np.uint8),
    )


def make_frame(frame: FrameRecord, stamp: int) -> Any:
    """Convert a frame to a sensor_msgs/Image or, for an image file, sensor_msgs/CompressedImage message object."""
    header = make_header(stamp, CAMERA_FRAME)
    if frame.pixels is None:
        data = np.frombuffer(frame.data or b"", dtype=np.uint8)
        return message_class(COMPRESSED_IMAGE)(header, frame.format, data)
    return image_message(frame.pixels, ENCODINGS[_kind(frame.pixels)], CAMERA_FRAME, stamp)


def read_frame(message: Any, stamp: int) -> FrameRecord:
    """Convert a sensor_msgs/Image or sensor_msgs/CompressedImage message object to a frame.

    Raises:
        MessageError: encoding, byte order or file format is not allowed, the image is empty, or the length of the data
            does not match its size.
    """
    if message.__msgtype__ == COMPRESSED_IMAGE:
        return FrameRecord(data=message.data.tobytes(), format=message.format, stamp=stamp)
    if message.encoding not in KINDS or message.is_bigendian:
        raise MessageError(
            f"encoding of a frame is {message.encoding!r}{' (big-endian)' if message.is_bigendian else ''}; "
            f"allowed: {', '.join(KINDS)} (little-endian)"
        )
    dtype, pixel = KINDS[message.encoding]
    shape = (message.height, message.width, *pixel)
    wanted = int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
    if message.data.size != wanted:
        raise MessageError(f"frame of {shape} {dtype} has {message.data.size} bytes; allowed: {wanted}")
    pixels = message.data.view(np.dtype(dtype).newbyteorder("<")).reshape(shape)
    return FrameRecord(pixels=pixels.astype(dtype, copy=False), stamp=stamp)
