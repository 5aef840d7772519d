"""Channels of pictures: cut out of a frame, once for all the stripes that a frame serves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Frame = npt.NDArray[Any]
Plane = npt.NDArray[Any]


def channel_of(frame: Frame, channel: int) -> Plane:
    """One channel of a frame (rows, columns[, channels]) as a contiguous picture."""
    if frame.ndim == 2:
        return np.ascontiguousarray(frame)
    if frame.shape[2] == 1:
        return np.ascontiguousarray(frame[:, :, 0])
    return np.asarray(cv2.extractChannel(np.ascontiguousarray(frame), channel))


class SharedFrame:
    """A frame that serves several stripes and that nobody writes into meanwhile.

    Attributes:
        frame: (rows, columns[, channels]).
    """

    def __init__(self, frame: Frame) -> None:
        """Begin with no channel cut out."""
        self.frame = frame
        self._planes: dict[int, Plane] = {}

    def plane(self, channel: int) -> Plane:
        """One channel, cut out when it is asked for first."""
        if channel not in self._planes:
            self._planes[channel] = channel_of(self.frame, channel)
        return self._planes[channel]


@dataclass(frozen=True, slots=True)
class OffRows:
    """Some rows with the laser off.

    Attributes:
        frame: (rows, columns[, channels]).
        shared: the whole frame that they are of, where it serves other stripes as well.
        first_row: that they begin with in it.
    """

    frame: Frame
    shared: SharedFrame | None = None
    first_row: int = 0

    def plane(self, channel: int) -> Plane:
        """One channel (rows, columns)."""
        if self.shared is None:
            return channel_of(self.frame, channel)
        return self.shared.plane(channel)[self.first_row : self.first_row + len(self.frame)]
