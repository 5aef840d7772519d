"""Robots that are alive on a router, and their state, from liveliness tokens and status messages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from transport.exceptions import MessageError, ScannerUnavailable
from transport.grids.evidence import read_report
from transport.keys import FLEET_ALIVE, FLEET_STATUS, alive_key, robot_of, status_key
from transport.links.liveliness import alive_keys
from transport.links.session import Session
from transport.messages.status_message import STATUS_NAME, Status, decode_status, number, whole_number
from transport.messages.terrain_message import Health
from transport.queries.asking import ask


@dataclass(frozen=True, slots=True)
class RobotState:
    """State of a robot, as reported by its node.

    Attributes:
        robot: instance name.
        step: number of the current or last stance pause; None if the node reports none.
        standing: True during a pause, False after it; None if unknown.
        age: time since the last grid was published [s]; NaN if there was none.
        health: worst level of all items of the status; STALE if the node is alive but did not reply.
        message: names and messages of the status items that are not OK; empty if all are OK; a note if there was no
            reply.
        links: number of Zenoh links of the node.
        run: identity of the node's run.
    """

    robot: str
    step: int | None = None
    standing: bool | None = None
    age: float = math.nan
    health: Health = Health.STALE
    message: str = "is alive, but did not reply to the status query"
    links: int = 0
    run: str = ""


def robot_states(session: Session, *, robots: Sequence[str] = (), timeout: float = 2.0) -> tuple[RobotState, ...]:
    """Query the state of all robots, or of the given ones, once; no grids are transferred.

    Args:
        session: open session of a client of the router.
        robots: instance names; empty = all robots, which requires the role `fleet` if certificates are used.
        timeout: time to wait for the replies to each query [s].

    Returns:
        State of each robot that is alive, sorted by name.

    Raises:
        ScannerUnavailable: none of the robots is alive and visible to this client.
        KeyNameError: one of `robots` cannot be part of a key.
        SessionClosed: the session is closed.
    """
    keys = [(alive_key(robot), status_key(robot)) for robot in robots] or [(FLEET_ALIVE, FLEET_STATUS)]
    found: dict[str, RobotState] = {}
    for alive, asked in keys:
        living = set(map(robot_of, alive_keys(session, alive, timeout)))
        found |= {robot: RobotState(robot) for robot in living}
        found |= {state.robot: state for state in _answers(session, asked, timeout) if state.robot in living}
    if not found:
        raise ScannerUnavailable(
            f"{'none of ' + ', '.join(robots) if robots else 'no robot'} was found. None is alive on this router, or "
            "this client lacks permission: with certificates, the role `fleet` sees all robots; other roles see only "
            "their own robot, if its name is given"
        )
    return tuple(found[robot] for robot in sorted(found))


def living_robots(session: Session, *, timeout: float = 2.0) -> tuple[str, ...]:
    """Return the sorted instance names of the robots that are alive on a router and visible to this client.

    Args:
        session: open session of a client of the router.
        timeout: time to wait for the router's reply [s].

    Raises:
        SessionClosed: the session is closed.
    """
    return tuple(sorted(map(robot_of, alive_keys(session, FLEET_ALIVE, timeout))))


def _answers(session: Session, key: str, timeout: float) -> list[RobotState]:
    states: list[tuple[int, RobotState]] = []
    for answer in ask(session, key, b"", timeout):
        with suppress(MessageError):
            status = decode_status(answer.payload or b"")
            state = _state_of(status)
            # The name in the status must match the key, so that no robot can report for another one.
            if state is not None and state.robot == robot_of(answer.key):
                states.append((status.stamp, state))
    # A router with a storage replies too, with an older status; sort so that the newest comes last.
    return [state for _, state in sorted(states, key=lambda entry: entry[0])]


def _state_of(status: Status) -> RobotState | None:
    """Return the state of the robot in a status; None if the status does not contain the robot's name."""
    own, report = status.item(STATUS_NAME), read_report(status, 0.0)
    if own is None or report is None or not own.hardware_id:
        return None
    wrong = [f"{item.name}: {item.message}" for item in status.items if item.level is not Health.OK]
    return RobotState(
        robot=own.hardware_id,
        step=report.step,
        standing=report.standing,
        age=number(own.values.get("last_scan_age_s", "")),
        health=status.level,
        message="; ".join(wrong),
        links=whole_number(own.values.get("links", "")) or 0,
        run=report.run,
    )
