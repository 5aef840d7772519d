"""`FramePair`: what the camera delivered of one stripe."""

from __future__ import annotations

from dataclasses import dataclass

from guara_perception.arrays import Image


@dataclass(frozen=True, slots=True)
class FramePair:
    """The pictures of one stripe. They are not copied: nothing may write into them before they have been processed.

    Attributes:
        index: index of the stripe in the standard pattern.
        on: picture with the laser on, (h, w) or (h, w, 3) BGR as OpenCV reads it, uint8 or uint16.
        off: picture with the laser off, or None: earlier frames of the sweep serve instead.
    """

    index: int
    on: Image
    off: Image | None = None
