"""The rows of a pair of frames in which one stripe is sought."""

from __future__ import annotations

from dataclasses import dataclass

from guara_perception.stripes.channels import Frame, OffRows


@dataclass(frozen=True, slots=True)
class Band:
    """One stripe's part of a pair of frames.

    Attributes:
        on: (rows, columns[, 3]) uint8 or uint16, laser on.
        off: the same rows with the laser off, or None.
        first_row: row of the first line in the full picture.
    """

    on: Frame
    off: OffRows | None
    first_row: int = 0

    @classmethod
    def of(cls, on: Frame, off: Frame | None, first_row: int = 0) -> Band:
        """The band of two arrays."""
        return cls(on, None if off is None else OffRows(off), first_row)
