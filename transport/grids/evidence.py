"""Evidence that a client has about a robot, and the rule that accepts or rejects a grid, however it was received.

This module does not wait and does not use Zenoh. All times are arguments, on the clock of `clock.now()` [s].
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import TypeVar

from transport.links.recent import Recent
from transport.messages.map_messages import RegionsMessage, SummaryMessage
from transport.messages.status_message import STATUS_NAME, Status, number, whole_number
from transport.messages.terrain_message import TerrainMessage

# Frame of all grids in this major version of the messages.
FRAME = "base_footprint"
# Longest silence during which the last report of a node still confirms a grid [s]. Nodes report once a second and on
# change; after three missing reports, the node may have stopped, or the next pause may have begun.
SILENT = 3.0
# Number of runs and of walks that are remembered; messages of remembered runs that have ended are rejected.
REMEMBERED = 64


Grid = TerrainMessage | SummaryMessage | RegionsMessage
G = TypeVar("G", bound=Grid)


class Cure(IntEnum):
    """Event that may resolve an objection to a grid: none, the return of the node, its next report, or a later grid."""

    NONE = 0
    RETURN = 1
    REPORT = 2
    GRID = 3


@dataclass(frozen=True, slots=True)
class Objection:
    """Reason not to use a grid.

    Attributes:
        text: rest of a sentence that begins with "the grid".
        cure: event that may resolve the objection.
    """

    text: str
    cure: Cure = Cure.NONE


@dataclass(frozen=True, slots=True)
class NodeReport:
    """Report of a node about its robot, from one status.

    Attributes:
        status: status that contains the report.
        heard: latest possible time of the report [s]; -inf after the liveliness token of the run was lost.
        run: identity of the run of the node; empty if the status does not contain it.
        clock: monotonic clock of the node at the report [s]; 0 if the status does not contain it.
        epoch: identity of the walk.
        step: number of the current or last stance pause; None before the first.
        standing: True during the pause, False after it; None if no pauses are announced, as in a replay.
        newest: sequence number last published or skipped, by extent; None = none yet.
        hears_gait: False if the node no longer receives messages of the gait controller, which may have begun another
            pause.
    """

    status: Status
    heard: float
    run: str
    clock: float
    epoch: str
    step: int | None
    standing: bool | None
    newest: Mapping[str, int | None]
    hears_gait: bool = True


def read_report(status: Status, heard: float) -> NodeReport | None:
    """Return the report in a status, or None if the status is not from a node of this package."""
    item = status.item(STATUS_NAME)
    if item is None:
        return None
    values = item.values
    reading = number(values.get("clock_s", ""))
    return NodeReport(
        status=status,
        heard=heard,
        run=values.get("run", ""),
        clock=reading if math.isfinite(reading) else 0.0,
        epoch=values.get("epoch", ""),
        step=whole_number(values.get("step", "")),
        standing={"true": True, "false": False}.get(values.get("standing", "")),
        newest={
            "footprint": whole_number(values.get("last_scan_sequence", "")),
            "map": whole_number(values.get("last_map_sequence", "")),
        },
        hears_gait=values.get("gait") != "silent",
    )


def silent_for(silence: float) -> str:
    """Return the rest of a sentence about a node whose last report is `silence` seconds old."""
    return f"has been silent {f'for {silence:.1f} s' if math.isfinite(silence) else 'since its link was lost'}"


def objections(
    grid: Grid,
    report: NodeReport | None,
    *,
    step: int | None = None,
    age: float,
    limit: float,
    silence: float = 0.0,
    is_gone: bool = False,
) -> tuple[Objection, ...]:
    """List the reasons not to use a grid; empty if it may be used.

    A grid may be used while a live node confirms it: within the last `SILENT` seconds, the run that made the grid has
    reported that the robot is on the same walk and within the grid's valid pauses, and that the node hears the gait
    controller. Between the END of a pause and the next BEGIN, that pause counts as the current one, but a grid that is
    still provisional may not be used. If no pauses are announced (a replay), a report made after the grid confirms it
    indefinitely. A grid without a run needs no confirmation while there is no report. In every case, the age must be
    within `limit`, and the grid must not have been withdrawn. If pauses are announced, a footprint grid must also have
    the last sequence number that its node has published or skipped.

    Args:
        grid: the grid.
        report: last report of the current or last run; None if there was none.
        step: newest step of the grid's walk among all grids received; None = unknown.
        age: time since the end of the grid's scan [s].
        limit: allowed age [s].
        silence: age of the report [s].
        is_gone: True if the liveliness token of the grid's run has disappeared.
    """
    found = []
    if grid.withdrawn:
        found.append(Objection("was withdrawn by its node: the robot may have moved, or the scan was faulty"))
    if not age <= limit:
        found.append(Objection(f"is {age:.2f} s old; allowed: {limit:g} s{'; its node is gone' if is_gone else ''}"))
    if report is None:
        if grid.run:
            found.append(Objection("is from a node that has not reported the robot's pause yet", Cure.REPORT))
        return tuple(found)
    if grid.run and report.run and grid.run != report.run:
        found.append(Objection(f"is from run {grid.run!r} of the node; run {report.run!r} has taken over since"))
        return tuple(found)
    kind = "footprint" if grid.extent == "footprint" else "map"
    newest = report.newest.get(kind)
    is_known = newest is not None and newest >= grid.sequence
    is_another_walk = bool(report.epoch and grid.epoch and report.epoch != grid.epoch)
    pauses = 0 if is_another_walk else max(s for s in (report.step, step, grid.step) if s is not None) - grid.step
    if is_another_walk:
        # A report that is older than the grid may not contain the grid's walk yet.
        cure = Cure.NONE if is_known else Cure.REPORT
        found.append(Objection(f"is from walk {grid.epoch!r}; the robot is on walk {report.epoch!r}", cure))
    elif pauses > grid.valid_pauses:
        frame = "; a footprint grid is valid only during its own pause" if kind == "footprint" else ""
        found.append(Objection(f"is {pauses} pause{'s' * (pauses != 1)} old; allowed: {grid.valid_pauses}{frame}"))
    if report.standing is None and (is_known or silence <= SILENT):
        # No pauses are announced, so no announcement can have been missed.
        return tuple(found)
    if is_gone:
        found.append(Objection("is no longer confirmed: its node is gone", Cure.RETURN))
    elif silence > SILENT:
        found.append(Objection(f"is no longer confirmed: its node {silent_for(silence)}", Cure.REPORT))
    elif not report.hears_gait:
        found.append(Objection("is no longer confirmed: its node has lost the gait controller", Cure.REPORT))
    if grid.provisional and (pauses or report.standing is False):
        found.append(Objection("was never confirmed, and its pause is over", Cure.GRID))
    if kind == "footprint" and newest is not None and newest > grid.sequence:
        text = f"is not the newest: its node has since published or skipped sequence {newest}"
        found.append(Objection(text, Cure.GRID))
    return tuple(found)


class Evidence:
    """Evidence about one robot, from all runs of its node.

    Attributes:
        last_report: last report of the current or last run; None before the first report.
        live: runs whose liveliness tokens exist.
    """

    def __init__(self, robot: str) -> None:
        """Start without any evidence; `robot` is the instance name."""
        self._robot = robot
        self._lock = threading.Lock()
        self._run = ""
        self._over: Recent[str, None] = Recent(REMEMBERED)
        self._sequences: dict[str, int] = {}
        self._steps: Recent[str, int] = Recent(REMEMBERED)
        self.live: frozenset[str] = frozenset()
        self._seen: Recent[str, None] = Recent(REMEMBERED)
        self.last_report: NodeReport | None = None

    def tokens(self, live: frozenset[str]) -> None:
        """Record the runs whose liveliness tokens exist."""
        with self._lock:
            lost, self.live = self.live - live, live
            for run in live:
                self._seen[run] = None
            # Announcements may have been missed while the token was lost, so a new report of the node is needed.
            if self.last_report is not None and self.last_report.run in lost:
                self.last_report = replace(self.last_report, heard=-math.inf)

    def report(self, status: Status, heard: float) -> str:
        """Record the report in a status and return "", or return the reason to reject the status.

        An accepted status without a report, or with one older than the last of its run, changes nothing.

        Args:
            status: received status.
            heard: latest possible time of the report [s].
        """
        report = read_report(status, heard)
        if report is None:
            return ""
        with self._lock:
            refusal = self._refused_run(report.run)
            if not report.run and self._run in self.live:
                refusal = f"it names no run, but run {self._run!r} is alive"
            last = self.last_report
            if not refusal and (last is None or last.run != report.run or last.clock <= report.clock):
                self.last_report = report
            return refusal

    def refusal(self, grid: Grid, extent: str, *, is_newest: bool = True) -> str:
        """Record a received grid and return "", or return the reason to reject it.

        Args:
            grid: received grid.
            extent: requested extent.
            is_newest: True if the grid must be newer than all earlier ones, as a published grid must; False for a reply
                to a query.
        """
        for what, given, wanted in (
            ("robot", grid.robot, self._robot),
            ("extent", grid.extent, extent),
            ("frame", grid.frame_id, FRAME),
        ):
            if given != wanted:
                return f"its {what} is {given!r}, not {wanted!r}"
        with self._lock:
            refusal = self._refused_run(grid.run) or (self._refused_order(grid) if is_newest else "")
            if not refusal and grid.run:
                self._steps[grid.epoch] = max(grid.step, self._steps.get(grid.epoch, grid.step))
            return refusal

    def against(self, grid: Grid, *, age: float, limit: float, now: float, was_lost: bool) -> tuple[Objection, ...]:
        """List the objections to a grid; `was_lost` is True if the node was alive and has disappeared."""
        with self._lock:
            report, step = self.last_report, self._steps.get(grid.epoch)
        # A node has two liveliness tokens, and that of its run may disappear a moment after the other.
        is_gone = was_lost or (grid.run in self._seen and grid.run not in self.live)
        silence = 0.0 if report is None else max(0.0, now - report.heard)
        return objections(grid, report, step=step, age=age, limit=limit, silence=silence, is_gone=is_gone)

    def _refused_run(self, run: str) -> str:
        # A sender without a run is an earlier version or another tool; its grids are only compared with the last
        # sequence number of the current run.
        if not run or run == self._run:
            return ""
        if run in self._over:
            return f"it is from run {run!r} of the node, but another has taken over since"
        if self._run and self._run in self.live:
            if run not in self.live:
                return f"it is from run {run!r}, which has no liveliness token, but run {self._run!r} is alive"
            return f"it is from run {run!r}, but run {self._run!r} is alive: two nodes have the name {self._robot!r}"
        if self._run:
            self._over[self._run] = None
        self._run, self._sequences = run, {}
        self._steps.clear()
        return ""

    def _refused_order(self, grid: Grid) -> str:
        last = self._sequences.get(grid.extent, 0)
        if grid.sequence <= last:
            return f"its sequence number {grid.sequence} is not above {last}, the last one received"
        if grid.run:
            # A sender without a run may have restarted, so the order of its grids carries no information.
            self._sequences[grid.extent] = grid.sequence
        return ""
