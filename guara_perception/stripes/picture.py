"""A picture whose channels are cut out once each, for all the stripes that it serves."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.stripes.windows import rows_from

Frame = npt.NDArray[Any]
Plane = npt.NDArray[Any]
Index = npt.NDArray[np.intp]


class Picture:
    """Some rows of a picture of one or more channels.

    Attributes:
        frame: (rows, columns[, channels]) as delivered.
    """

    def __init__(self, frame: Frame, whole: Picture | None = None, first_row: int = 0) -> None:
        """Look at a frame, or at those rows of a `whole` picture that begin with `first_row`."""
        self.frame = frame
        self._whole, self._first_row = whole, first_row
        self._planes: dict[int, Plane] = {}

    def rows(self, first: int, end: int) -> Picture:
        """The rows from `first` to before `end`; they share the channels that are cut out of this picture."""
        return Picture(self.frame[first:end], self, first)

    @property
    def channels(self) -> int:
        """How many there are."""
        return self.frame.shape[2] if self.frame.ndim == 3 else 1

    def plane(self, channel: int) -> Plane:
        """One channel (rows, columns), in one piece of memory."""
        if self._whole is not None:
            return self._whole.plane(channel)[self._first_row : self._first_row + len(self.frame)]
        if channel not in self._planes:
            self._planes[channel] = channel_of(self.frame, channel)
        return self._planes[channel]

    def windows(self, first: Index, count: int, columns: Index, channel: int) -> Plane:
        """Values (count, n) of one channel in windows of rows, as of `rows_from`; for few of them none is cut out."""
        if channel in (self if self._whole is None else self._whole)._planes:
            return rows_from(self.plane(channel), first, count, columns)
        return rows_from(self.frame, first, count, columns, channel)


def channel_of(frame: Frame, channel: int) -> Plane:
    """One channel as a contiguous picture."""
    if frame.ndim == 2:
        return np.ascontiguousarray(frame)
    if frame.shape[2] == 1:
        return np.ascontiguousarray(frame[:, :, 0])
    return np.asarray(cv2.extractChannel(np.ascontiguousarray(frame), channel))
