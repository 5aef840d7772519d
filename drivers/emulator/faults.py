"""The faults that can be injected into the emulated board, and the plan that says when each strikes."""

from __future__ import annotations

import enum
import threading
from collections.abc import Collection
from dataclasses import dataclass, replace

from drivers.board.protocol import Request


class FaultKind(enum.Enum):
    """What goes wrong; the first group on the bus, the second in the device."""

    UNPLUG = "unplug"
    """The device leaves the bus before the transfer does anything."""
    UNPLUG_AFTER = "unplug_after"
    """The command is carried out, then the device leaves the bus in the middle of the answer."""
    STALL = "stall"
    TIMEOUT = "timeout"
    """The command is lost."""
    TIMEOUT_AFTER = "timeout_after"
    """The command is carried out but its answer is lost."""
    SHORT_READ = "short_read"
    GARBAGE = "garbage"
    NO_PERMISSION = "no_permission"
    """Opening fails for want of permission."""
    BUSY = "busy"
    """Claiming fails because another program holds the interface."""

    LOST_STEP = "lost_step"
    """The motor misses `amount` steps in its next motion, unnoticed by the firmware."""
    LASER_STUCK_ON = "laser_stuck_on"
    LASER_STUCK_OFF = "laser_stuck_off"
    BLIND_SENSOR = "blind_sensor"
    """The photodiode repeats the command instead of what it sees, so that only a camera finds out."""
    HOT = "hot"
    """The temperature becomes `amount` degrees Celsius."""
    WRONG_VERSION = "wrong_version"
    """The firmware speaks protocol `amount` (major x 256 + minor)."""
    NO_HOME_SWITCH = "no_home_switch"
    JAMMED = "jammed"
    """The mirror never reports to be still."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Attributes:
        kind: what goes wrong.
        request: strike only at this command (or `"report"`, `"open"`, `"claim"`); None for any command.
        skip: let this many matching transfers pass first.
        count: strike this often.
        amount: steps, degrees or version, where the kind says so.
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
                if fault.kind not in kinds or not _matches(fault, at):
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


def _matches(fault: Fault, at: Request | str) -> bool:
    if fault.request is None:
        return isinstance(at, Request)
    return fault.request == at
