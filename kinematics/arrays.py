"""Array types of this package, and conversion to read-only arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def read_only(array: npt.ArrayLike) -> Array:
    """Convert to a read-only array whose memory cannot be written through another array either.

    An array whose memory is already read-only is returned unchanged. Any other array is copied, so that the caller's
    array stays writable.
    """
    given = np.asarray(array)
    if _is_frozen(given):
        return given
    copy = np.array(given)
    copy.setflags(write=False)
    return copy


class FrozenArrays:
    """Base class of frozen dataclasses that makes their array fields read-only."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:  # type: ignore[attr-defined]  # quicker than `fields`
            if isinstance(value := getattr(self, name), np.ndarray) and not _is_frozen(value):
                object.__setattr__(self, name, read_only(value))


def _is_frozen(array: Array) -> bool:
    """Check that an array and all its base arrays are read-only, and that no other object can write to their memory."""
    memory: Any = array
    while isinstance(memory, np.ndarray):
        if memory.flags.writeable:
            return False
        memory = memory.base
    return memory is None or isinstance(memory, bytes)
