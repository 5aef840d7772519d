"""Types of arrays of this package, and read-only arrays."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def read_only(array: npt.ArrayLike) -> Array:
    """The same values in an array that cannot be written, not even through another array on the same memory.

    An array whose memory is read-only already is returned as it is. Any other is copied, so that the caller's array
    stays writable.
    """
    given = np.asarray(array)
    if _is_frozen(given):
        return given
    copy = np.array(given)
    copy.setflags(write=False)
    return copy


class FrozenArrays:
    """Base of frozen dataclasses that makes their array fields read-only."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for entry in fields(self):  # type: ignore[arg-type]
            if isinstance(value := getattr(self, entry.name), np.ndarray):
                object.__setattr__(self, entry.name, read_only(value))


def _is_frozen(array: Array) -> bool:
    """Test that the array and everything that it is a view of are read-only."""
    memory: Any = array
    while isinstance(memory, np.ndarray):
        if memory.flags.writeable:
            return False
        memory = memory.base
    return memory is None or isinstance(memory, bytes)
