"""Faults of the emulated board, and when they occur."""

from __future__ import annotations

import enum
import threading
from collections.abc import Collection
from dataclasses import dataclass, replace

from drivers.board.protocol import Request


class FaultKind(enum.Enum):
    """Kinds of faults: the first nine occur on the bus, the others in the device.

    Attributes:
        UNPLUG: the device is unplugged before the transfer.
        UNPLUG_AFTER: the command is executed, then the device is unplugged during the reply.
        STALL: the transfer stalls.
        TIMEOUT: the command is lost.
        TIMEOUT_AFTER: the command is executed but its reply is lost.
        SHORT_READ: half of the reply is missing.
        GARBAGE: the reply is random.
        NO_PERMISSION: opening fails for lack of permission.
        BUSY: claiming fails because another program uses the interface.
        LOST_STEP: the motor loses `amount` steps in its next motion, unnoticed by the firmware.
        LASER_STUCK_ON, LASER_STUCK_OFF: the laser does not follow its command.
        BLIND_SENSOR: the photodiode reports the command, so that only a camera sees the laser.
        HOT: the temperature becomes `amount` degrees Celsius.
        WRONG_VERSION: the firmware has protocol `amount` (major x 256 + minor).
        NO_HOME_SWITCH: the mirror does not find its home switch.
        JAMMED: the mirror never reports that it is still.
    """

    UNPLUG = "unplug"
    UNPLUG_AFTER = "unplug_after"
    STALL = "stall"
    TIMEOUT = "timeout"
    TIMEOUT_AFTER = "timeout_after"
    SHORT_READ = "short_read"
    GARBAGE = "garbage"
    NO_PERMISSION = "no_permission"
    BUSY = "busy"
    LOST_STEP = "lost_step"
    LASER_STUCK_ON = "laser_stuck_on"
    LASER_STUCK_OFF = "laser_stuck_off"
    BLIND_SENSOR = "blind_sensor"
    HOT = "hot"
    WRONG_VERSION = "wrong_version"
    NO_HOME_SWITCH = "no_home_switch"
    JAMMED = "jammed"


@dataclass(frozen=True, slots=True)
class Fault:
    """Fault to inject.

    Attributes:
        kind: kind of the fault.
        request: command (or `"report"`, `"open"`, `"claim"`) at which it occurs; None = any command.
        skip: number of matching transfers before it occurs.
        count: number of times that it occurs.
        amount: steps, degrees or version, for kinds that have one.
    """

    kind: FaultKind
    request: Request | str | None = None
    skip: int = 0
    count: int = 1
    amount: int = 0


class FaultPlan:
    """Pending faults; thread-safe."""

    def __init__(self) -> None:
        """Start without faults."""
        self._waiting: list[Fault] = []
        self._lock = threading.Lock()

    def add(self, fault: Fault) -> None:
        """Add a fault."""
        with self._lock:
            self._waiting.append(fault)

    def clear(self) -> None:
        """Remove all faults."""
        with self._lock:
            self._waiting.clear()

    def holds(self, kind: FaultKind) -> Fault | None:
        """Pending fault of a kind, which acts as a state; or None."""
        if not self._waiting:
            return None
        with self._lock:
            return next((fault for fault in self._waiting if fault.kind is kind), None)

    def strike(self, at: Request | str, kinds: Collection[FaultKind]) -> Fault | None:
        """Return the fault among `kinds` that occurs at this transfer, and count it; or None."""
        if not self._waiting:
            return None
        with self._lock:
            for number, fault in enumerate(self._waiting):
                is_here = isinstance(at, Request) if fault.request is None else fault.request == at
                if fault.kind not in kinds or not is_here:
                    continue
                if fault.skip > 0:
                    self._waiting[number] = replace(fault, skip=fault.skip - 1)
                    continue
                if fault.count > 1:
                    self._waiting[number] = replace(fault, count=fault.count - 1)
                else:
                    del self._waiting[number]
                return fault
        return None
