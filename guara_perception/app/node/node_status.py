"""Status items of the node, such as last scan, calibration, drift and pause, and the newest problem per subsystem."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from guara_perception.app.messages import LEVELS
from guara_perception.calibration.drift import DRIFTING, UNKNOWN, Drift, DriftWatch
from guara_perception.terrain.layers.record import Health as GridHealth
from guara_perception.terrain.layers.record import ScanRecord
from transport import Health, StatusItem, TransportError
from transport.security.certificates import judge_security

if TYPE_CHECKING:
    from guara_perception.app.node.live_scan import LiveScan
    from guara_perception.app.node.pause import Pause
    from guara_perception.calibration.calibration import Calibration
    from guara_perception.terrain.grid import TerrainGrid

VERDICTS = {"good": Health.OK, "usable": Health.OK, "unknown": Health.WARN, "refused": Health.ERROR}


class NodeStatus:
    """Thread-safe collection of the node's status items."""

    def __init__(self, calibration: Calibration | None = None) -> None:
        """Create the items before the first scan.

        Args:
            calibration: calibration in use, whose verdict is part of every status; None = no such item.
        """
        self._lock = threading.RLock()
        self._items: dict[str, StatusItem] = {}
        self._problems: dict[str, tuple[float, str]] = {}
        self._followed: list[Callable[[], StatusItem]] = []
        self._drift = DriftWatch()
        self._scans = 0
        self._failures = 0
        self._withdrawn: Counter[str] = Counter()
        self.on_change: Callable[[], None] = lambda: None
        self.on_scan: Callable[[TerrainGrid], None] = lambda terrain: None
        if calibration is not None:
            verdict = str(calibration.quality.get("verdict"))
            reasons = "; ".join(map(str, calibration.quality.get("reasons", ())))
            message = f"{verdict}: {reasons}" if reasons else verdict
            values = {"hash": calibration.hash, "created": calibration.created}
            self.note("calibration", message, VERDICTS.get(verdict, Health.WARN), values)

    def scanned(self, terrain: TerrainGrid, scan: LiveScan, latency: float) -> None:
        """Report a finished scan.

        Args:
            terrain: grid of the scan.
            scan: times and faults of the devices during the scan.
            latency: time from the last frame until the grid was passed on for sending [s].
        """
        record = terrain.record
        health = record.health or GridHealth()
        seconds = (record.seconds if isinstance(record, ScanRecord) else None) or {}
        with self._lock:
            self._scans += 1
            self._problems.pop("scan", None)
            values = {
                "step": str(terrain.step),
                "mode": str(record.mode),
                "coverage": f"{record.coverage or 0.0:.3f}",
                "duration_s": f"{(scan.end - scan.start) * 1e-9:.3f}",
                "latency_ms": f"{latency * 1e3:.1f}",
                "provisional": "true",
                "scans": str(self._scans),
                "failures": str(self._failures),
                **{f"seconds_{stage}": f"{spent:.4f}" for stage, spent in seconds.items()},
            }
            message = "; ".join(health.reasons) or "last scan is good"
            self.note("scanner", message, LEVELS.get(health.level, Health.WARN), values)
        self.on_change()
        self.on_scan(terrain)

    def confirmed(self, step: int) -> None:
        """Report that the grid of a step is confirmed, if it is the newest grid."""
        with self._lock:
            scanner = self._items.get("scanner")
            if scanner is not None and scanner.values["step"] == str(step):
                self._items["scanner"] = dataclasses.replace(scanner, values={**scanner.values, "provisional": "false"})
        self.on_change()

    def withdrawn(self, cause: str) -> None:
        """Count a withdrawn grid by cause.

        Causes are "moved" (the robot moved or may have moved), "late" (the confirming joints were read before the last
        frame) and "clock" (the gait's clock is unknown).
        """
        with self._lock:
            self._withdrawn[cause] += 1
            values = {name: str(count) for name, count in self._withdrawn.items()}
            self.note("withdrawn", f"{self._withdrawn.total()} grids since the start", Health.OK, values)

    def drift(self, drift: Drift) -> None:
        """Report how well the floor of the last scan agrees with the calibration; a single scan causes no warning."""
        self._drift.add(drift)
        verdict, counts = self._drift.verdict, self._drift.counts
        values = {"verdict": verdict, **{f"scans_{name}": str(count) for name, count in counts.items()}}
        of_scan = drift.to_dict().items()
        values |= {name: str(value) for name, value in of_scan if name not in ("reasons", "verdict")}
        scans = sum(counts.values())
        message = f"calibration: {verdict}, floor found in {scans - counts[UNKNOWN]} of {scans} scans"
        message = "; ".join((message, *(f"last scan: {reason}" for reason in drift.reasons)))
        self.note("drift", message, Health.WARN if verdict == DRIFTING else Health.OK, values)

    def light(self, margins: Mapping[str, float]) -> None:
        """Report the light margins of the last scan, by name."""
        values = {name: f"{margin:.3f}" for name, margin in margins.items()}
        self.note("light", "margins of the last scan", Health.OK, values)

    def problem(self, subsystem: str, message: str) -> None:
        """Report a problem of a subsystem until `solved` (for "scan": `scanned`) is called, or another replaces it."""
        with self._lock:
            if subsystem == "scan":
                self._failures += 1
            self._problems[subsystem] = (time.time(), message)
        self.on_change()

    def solved(self, subsystem: str) -> None:
        """Report that a subsystem works again."""
        with self._lock:
            self._problems.pop(subsystem, None)

    def note(
        self, name: str, message: str, level: Health = Health.WARN, values: Mapping[str, str] | None = None
    ) -> None:
        """Add or replace an item; an empty message removes it."""
        with self._lock:
            if message:
                self._items[name] = StatusItem(name=name, level=level, message=message, values=values or {})
            else:
                self._items.pop(name, None)

    def follow(self, item: Callable[[], StatusItem]) -> None:
        """Call `item` for every status, and add its result; the call must be quick."""
        with self._lock:
            self._followed.append(item)

    def items(self) -> list[StatusItem]:
        """All items; a problem is an error item named after its subsystem."""
        with self._lock:
            items, followed = list(self._items.values()), list(self._followed)
            for subsystem, (when, message) in self._problems.items():
                values = {"seconds_ago": f"{time.time() - when:.1f}"}
                items.append(StatusItem(name=subsystem, level=Health.ERROR, message=message, values=values))
        return [*items, *(item() for item in followed)]


def pause_item(pause: Pause | None, is_scanned: bool, gait_clock: tuple[float, float] | None = None) -> StatusItem:
    """Status item of the newest pause: state of the robot, and what the next grid requires.

    Args:
        pause: the newest pause; None before the first.
        is_scanned: True if the scan of this pause is done or was abandoned.
        gait_clock: current reading of the gait's clock and its error bound [s]; None if unknown.
    """
    if pause is None:
        message = "no stance pause has been announced yet: nothing is scanned until the gait sends BEGIN"
        return StatusItem(name="pause", level=Health.OK, message=message, values={"state": "none"})
    seconds = time.monotonic() - pause.begun
    if pause.ended.is_set():
        state, message = "moving", "the pause is over; the next grid comes with the next pause"
    elif is_scanned:
        state = "standing"
        message = (
            f"the robot has stood for {seconds:.0f} s; its scan is done: the next grid comes with the next pause or a "
            "requested scan"
        )
    else:
        state, message = "scanning", "the robot stands; its scan is not done yet"
    values = {"state": state, "step": str(pause.step), "epoch": pause.epoch, "seconds": f"{seconds:.1f}"}
    if gait_clock is not None:
        values |= {"clock_ahead_s": f"{gait_clock[0] - time.time():.4f}", "clock_bound_s": f"{gait_clock[1]:.4f}"}
    return StatusItem(name="pause", level=Health.OK, message=f"step {pause.step}: {message}", values=values)


def certificates_item(folder: Path) -> StatusItem:
    """Status item of the security folder: expiry of certificates, permissions of keys, version of the access rules."""
    try:
        level, message = judge_security(folder)
    except TransportError as error:
        level, message = Health.WARN, str(error)
    return StatusItem(name="certificates", level=level, message=message)
