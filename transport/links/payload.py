"""Payloads that are made when somebody wants them."""

from __future__ import annotations

import threading
from collections.abc import Callable

Payload = bytes | bytearray


class MadeOnce:
    """A payload that costs time: made when first asked for, by whoever asks first, and kept."""

    def __init__(self, make: Callable[[], Payload]) -> None:
        """Make nothing yet."""
        self._make: Callable[[], Payload] | None = make
        self._made: Payload = b""
        self._lock = threading.Lock()

    def __call__(self) -> Payload:
        """The payload."""
        with self._lock:
            if self._make is not None:
                self._made, self._make = self._make(), None
            return self._made
