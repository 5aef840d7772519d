"""Dictionary of limited size that keeps the most recently set entries."""

from __future__ import annotations

from typing import TypeVar

K = TypeVar("K")
V = TypeVar("V")


class Recent(dict[K, V]):
    """Dictionary with at most `most` entries, the most recently set ones; set entries only by `self[key] = value`."""

    def __init__(self, most: int) -> None:
        """Create an empty dictionary."""
        super().__init__()
        self._most = most

    def __setitem__(self, key: K, value: V) -> None:
        """Set an entry, and drop the least recently set one if there are too many."""
        self.pop(key, None)
        super().__setitem__(key, value)
        while len(self) > self._most:
            del self[next(iter(self))]
