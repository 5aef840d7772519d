"""Faults of the emulated board, and the plan of their occurrence."""

from __future__ import annotations

import enum
import threading
from collections.abc import Collection
from dataclasses import dataclass, replace

from drivers.board.protocol import Request


class FaultKind(enum.Enum):
    """Kinds of faults: the first nine strike on the bus, the others in the device.

    Attributes:
        UNPLUG: the device leaves the bus before the transfer does anything.
        UNPLUG_AFTER: the command is carried out, then the device leaves the bus in the middle of the answer.
        STALL: the transfer stalls.
        TIMEOUT: the command is lost.
        TIMEOUT_AFTER: the command is carried out but its answer is lost.
        SHORT_READ: half of the answer is missing.
        GARBAGE: the answer is random.
        NO_PERMISSION: opening fails for want of permission.
        BUSY: claiming fails because another program holds the interface.
        LOST_STEP: the motor misses `amount` steps in its next motion, unnoticed by the firmware.
        LASER_STUCK_ON, LASER_STUCK_OFF: the laser does not follow its command.
        BLIND_SENSOR: the photodiode repeats the command, so that only a camera can tell.
        HOT: the temperature becomes `amount` degrees Celsius.
        WRONG_VERSION: the firmware speaks protocol `amount` (major x 256 + minor).
        NO_HOME_SWITCH: the mirror never meets its home switch.
        JAMMED: the mirror never reports to be still.
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
    """One fault.

    Attributes:
        kind: kind of the fault.
        request: command (or `"report"`, `"open"`, `"claim"`) at which it strikes; None for any command.
        skip: number of matching transfers that pass before.
        count: number of times that it strikes.
        amount: steps, degrees or version, for the kinds that have one.
    """

    kind: FaultKind
    request: Request | str | None = None
    skip: int = 0
    count: int = 1
    amount: int = 0


class FaultPlan:
    """The faults waiting to strike; thread-safe."""

    def __init__(self) -> None:
        """Begin with none."""
        self._waiting: list[Fault] = []
        self._lock = threading.Lock()

    def add(self, fault: Fault) -> None:
        """Let `fault` wait for its turn."""
        with self._lock:
            self._waiting.append(fault)

    def clear(self) -> None:
        """Forget every fault."""
        with self._lock:
            self._waiting.clear()

    def holds(self, kind: FaultKind) -> Fault | None:
        """The fault of a kind that holds as a state, or None."""
        if not self._waiting:
            return None
        with self._lock:
            return next((fault for fault in self._waiting if fault.kind is kind), None)

    def strike(self, at: Request | str, kinds: Collection[FaultKind]) -> Fault | None:
        """The fault among `kinds` that strikes at this transfer, which is counted; None without one."""
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
