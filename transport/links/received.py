"""Received messages with their time of arrival, decoded at their first use."""

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
        number: number of the sample at this receiver, from 1.
        arrival: time of arrival by `transport.clock.now()` [s].
        arrival_stamp: time of arrival by this machine's wall clock [ns since the epoch].
    """

    message: T
    number: int
    arrival: float
    arrival_stamp: int

    @property
    def age(self) -> float:
        """Time since the arrival [s]."""
        return clock.now() - self.arrival


class Sample(Generic[T]):
    """Payload with its time of arrival, decoded at most once."""

    def __init__(self, payload: bytes, number: int, decode: Callable[[bytes], T]) -> None:
        """Record the current time as the time of arrival."""
        self.number = number
        self.taken = False
        self._arrival = (clock.now(), time.time_ns())
        self._payload = payload
        self._decode = decode
        self._lock = threading.Lock()
        self._result: Received[T] | MessageError | None = None

    def open(self, *, counts: bool = True) -> Received[T]:
        """Decode the message; it then counts as read unless `counts` is False.

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
