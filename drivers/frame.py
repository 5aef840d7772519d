"""Camera frame: an image with its frame number and times."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.arrays import Image


@dataclass(frozen=True, slots=True)
class Frame:
    """Frame of a camera. Do not compare frames with `==`; compare their images with numpy.

    Attributes:
        image: (height, width) or (height, width, 3) BGR, uint8 or uint16; read-only.
        counter: frame number. If the numbers come from the device (`Camera.counts_frames`), a gap means lost or
            damaged frames.
        stamp: time at which the frame arrived at the host or, with some cameras, was read, on the monotonic clock [s].
        device_time: start of the exposure on the camera's own clock [s]; None if the camera does not report it.
    """

    image: Image
    counter: int
    stamp: float
    device_time: float | None = None


def read_only(image: Image) -> Image:
    """Return a read-only view of `image`."""
    view = image.view()
    view.setflags(write=False)
    return view
