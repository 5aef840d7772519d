"""The rows of a pair of frames in which one stripe is sought."""

from __future__ import annotations

from dataclasses import dataclass

from guara_perception.stripes.picture import Frame, Picture


@dataclass(frozen=True, slots=True)
class Band:
    """One stripe's part of a pair of frames.

    Attributes:
        on: (rows, columns[, 3]) uint8 or uint16, laser on.
        off: the same rows with the laser off, or None.
        first_row: row of the first line in the full picture.
    """

    on: Picture
    off: Picture | None
    first_row: int = 0

    @classmethod
    def of(cls, on: Frame, off: Frame | None, first_row: int = 0) -> Band:
        """The band of two arrays."""
        return cls(Picture(on), None if off is None else Picture(off), first_row)
