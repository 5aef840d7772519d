"""Received messages with their time of arrival; each is decoded at its first use."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from transport import clock
from transport.exceptions import MessageError

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Received(Generic[T]):
    """Message with its time of arrival.

    Attributes:
        message: decoded message.
        number: number of the sample among those that its receiver accepted, from 1.
        arrival: time of arrival on the clock `transport.clock.now()` [s].
        arrival_stamp: time of arrival on this machine's wall clock [ns since the Unix epoch].
    """

    message: T
    number: int
    arrival: float
    arrival_stamp: int

    @property
    def age(self) -> float:
        """Time since the message arrived [s]."""
        return clock.now() - self.arrival


class Sample(Generic[T]):
    """Received payload with its time of arrival; decoded at most once."""

    def __init__(self, payload: bytes, number: int, decode: Callable[[bytes], T]) -> None:
        """Create a sample whose time of arrival is now."""
        self.number = number
        self.taken = False
        self._arrival = (clock.now(), time.time_ns())
        self._payload = payload
        self._decode = decode
        self._lock = threading.Lock()
        self._result: Received[T] | MessageError | None = None

    def open(self, *, counts: bool = True) -> Received[T]:
        """Decode the message and return it; mark the sample as read unless `counts` is False.

        Raises:
            MessageError: the payload is not a valid message.
        """
        self.taken |= counts
        with self._lock:
            if self._result is None:
                try:
                    self._result = Received(self._decode(self._payload), self.number, *self._arrival)
                except MessageError as error:
                    self._result = error
            if isinstance(self._result, MessageError):
                raise self._result
            return self._result
