"""One picture of a camera, with its number and its time."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.arrays import Image


@dataclass(frozen=True, slots=True)
class Frame:
    """One picture; compare images with numpy.

    Attributes:
        image: (height, width) or (height, width, 3) BGR, uint8 or uint16; read-only.
        counter: number of the frame in the camera's own counting, growing by 1; a gap is a dropped frame.
        stamp: when the host had the frame, on the monotonic clock [s].
        device_time: when its exposure began, on the camera's own clock [s]; None when the camera does not report it.
    """

    image: Image
    counter: int
    stamp: float
    device_time: float | None = None


def read_only(image: Image) -> Image:
    """A view of `image` that cannot be written to."""
    view = image.view()
    view.setflags(write=False)
    return view
