"""Zenoh access rules by role, for a node that is its own router and for a router that serves several robots."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from transport.keys import (
    FLEET_ALIVE,
    FLEET_STATUS,
    claim_key,
    gait_clock_key,
    grid_keys,
    perception_prefix,
    query_key,
    scan_key,
    stance_key,
    stance_stream_key,
    status_key,
    summary_key,
)

# Roles of a robot's members, each with a certificate. A node that is its own router enforces the rules of the others.
ROLES = ("node", "gait", "planner", "viewer")

# Roles that belong to no robot: site router, and fleet member, which may list the live robots and read their status.
ROUTER, FLEET = "router", "fleet"

LOOKING = ("liveliness_query", "declare_liveliness_subscriber")
SUBSCRIBING = ("declare_subscriber", *LOOKING)
QUERYING = (*SUBSCRIBING, "query")
SERVING = ("put", "reply", "declare_queryable", "liveliness_token")
FLEET_KEYS = (FLEET_STATUS, FLEET_ALIVE)

# Rules of planner, viewer and gait. A router that reads from a node must not announce stances, and may request scans
# only if explicitly permitted, because its certificate stands for all clients behind it.
READING = ("read", "history", "send", "ask")
POLICIES = {"planner": (*READING, "trigger"), "viewer": READING, "gait": ("stance_in", "stance_out")}
THIN = ("thin_read", "thin_ask", "thin_send")
WATCHING = ("fleet_read", "fleet_ask", "fleet_send")
# Rules of a router: SOURCE for a link that delivers a robot's grids, CLIENT_NODE for a node that is a client of the
# router; such a node also receives stance pauses.
SOURCE = ("source_in", "source_out", "look", "looked")
CLIENT_NODE = (*SOURCE, "stance_to", "stance_from")


@dataclass(frozen=True, slots=True)
class Neighbours:
    """Routers linked to a router, by the common names of their certificates.

    Attributes:
        above: routers to which this router connects; they read from it.
        below: routers that connect to this router, with the robots whose grids each may send.
        scans: True if the routers above may request scans.
        summary_only: True if the routers above receive only summaries, status and liveliness tokens.
    """

    above: Sequence[str] = ()
    below: Mapping[str, Sequence[str]] = field(default_factory=dict)
    scans: bool = False
    summary_only: bool = False


class _Rules:
    """Builder of the section `access_control` of a Zenoh configuration: rules, subjects and policies."""

    def __init__(self) -> None:
        self._rules: dict[str, dict[str, Any]] = {}
        self._subjects: list[dict[str, Any]] = []
        self._policies: list[dict[str, Any]] = []

    def write(self, name: str, flow: str, messages: Iterable[str], keys: Iterable[str]) -> None:
        # Without `flows`, a rule would apply to both directions.
        rule = {"id": name, "permission": "allow", "flows": [flow]}
        self._rules[name] = {**rule, "messages": list(messages), "key_exprs": list(keys)}

    def allow(self, subject: str, names: Sequence[str], rules: Sequence[str]) -> None:
        """Grant rules to the owners of common names; without names, to nobody. An empty subject would match all."""
        if names:
            # The subject has a single property, because all properties of a subject must match.
            self._subjects.append({"id": subject, "cert_common_names": list(names)})
            self._policies.append({"rules": list(rules), "subjects": [subject]})

    def section(self) -> dict[str, Any]:
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": list(self._rules.values()),
            "subjects": self._subjects,
            "policies": self._policies,
        }


def access_control(
    robot: str,
    members: Mapping[str, Sequence[str]] | None = None,
    *,
    routers: Sequence[str] = (),
    scanning_routers: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the section `access_control` of the Zenoh configuration of a node that is its own router.

    Only the following is allowed. Planner and viewer read everything under `<robot>/perception/v1` and query the newest
    grid and the status. The planner also requests scans. The gait publishes stance pauses and the stance stream, and
    serves its clock. A second node of the same robot may announce that it is waiting for the robot's name. A router
    linked to the node has the rights of a viewer, or of a planner if it is one of `scanning_routers`, and may watch
    status and tokens of all robots.

    Args:
        robot: instance name.
        members: common names of the members by role; None = one member per role, named after the role.
        routers: common names of the routers that may read what the node publishes.
        scanning_routers: those of `routers` that may also request scans, on behalf of the clients behind them.
    """
    rules = _Rules()
    _write_reading(rules, robot)
    rules.write("claim", "ingress", ["liveliness_token"], [claim_key(robot)])
    if routers:
        _write_watching(rules)
    for role, allowed in {**POLICIES, "node": ("claim",)}.items():
        rules.allow(role, list((members or {}).get(role, [] if members else [role])), allowed)
    rules.allow(ROUTER, [name for name in routers if name not in scanning_routers], (*READING, *WATCHING))
    rules.allow("scanning router", scanning_routers, (*READING, *WATCHING, "trigger"))
    return rules.section()


def router_access_control(
    robots: Mapping[str, Mapping[str, Sequence[str]]], *, neighbours: Neighbours, fleet: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the section `access_control` of a router that serves several robots.

    Planner, viewer and gait of each robot have the same rights as at their node, and none for other robots. Each node
    publishes under `<robot>/perception/v1` of its own robot, and receives the robot's stance pauses. A router below
    may only publish for its robots and look for their nodes. A router above reads and, if permitted, requests scans. No
    link between routers transfers stance pauses.

    Args:
        robots: common names of the members, by robot (instance name) and role.
        neighbours: routers linked to this router.
        fleet: common names of the members that may list the live robots and read their status.
    """
    rules = _Rules()
    _write_watching(rules)
    for robot, members in robots.items():
        _write_reading(rules, robot, f"{robot} ")
        _write_source(rules, robot)
        for role, allowed in {**POLICIES, "node": CLIENT_NODE}.items():
            rules.allow(f"{robot} {role}", list(members.get(role, ())), [f"{robot} {rule}" for rule in allowed])
    for name, brought in neighbours.below.items():
        allowed = tuple(f"{robot} {rule}" for robot in brought if robot in robots for rule in SOURCE)
        if allowed:
            rules.allow(f"below {name}", [name], allowed)
    reading = THIN if neighbours.summary_only else (*READING, "trigger") if neighbours.scans else READING
    if neighbours.summary_only:
        for robot in robots:
            _write_thin(rules, robot)
    above = tuple(f"{robot} {rule}" for robot in robots for rule in reading)
    rules.allow("above", neighbours.above, (*above, *WATCHING))
    rules.allow(FLEET, fleet, WATCHING)
    return rules.section()


def _perception(robot: str) -> list[str]:
    # `**` does not match chunks that begin with `@`, so these are listed separately.
    prefix = perception_prefix(robot)
    return [f"{prefix}/**", f"{prefix}/**/@adv/**", _alive(robot)]


def _alive(robot: str) -> str:
    """Return the key expression of a robot's liveliness tokens."""
    return f"{perception_prefix(robot)}/@alive/**"


def _stance_keys(robot: str) -> list[str]:
    """Return the keys of the gait's stance pauses, stance stream and clock."""
    stance = stance_key(robot)
    return [stance, f"{stance}/@adv/**", stance_stream_key(robot), gait_clock_key(robot)]


def _write_reading(rules: _Rules, robot: str, label: str = "") -> None:
    """Add rules for reading what a robot publishes, querying grids, requesting scans and announcing stance pauses."""
    perception, stance_keys = _perception(robot), _stance_keys(robot)
    rules.write(f"{label}read", "ingress", SUBSCRIBING, perception)
    rules.write(f"{label}history", "ingress", ["query"], [f"{perception_prefix(robot)}/**/@adv/**"])
    rules.write(f"{label}send", "egress", SERVING, perception)
    rules.write(f"{label}ask", "ingress", ["query"], [query_key(robot), status_key(robot), *grid_keys(robot)])
    rules.write(f"{label}trigger", "ingress", ["query"], [scan_key(robot)])
    rules.write(f"{label}stance_in", "ingress", SERVING, stance_keys)
    rules.write(f"{label}stance_out", "egress", QUERYING, stance_keys)


def _write_source(rules: _Rules, robot: str) -> None:
    """Add rules for the link to a robot's node, or to the router between this router and the node."""
    perception, stance_keys = _perception(robot), _stance_keys(robot)
    rules.write(f"{robot} source_in", "ingress", SERVING, perception)
    rules.write(f"{robot} source_out", "egress", QUERYING, [*perception, *FLEET_KEYS])
    # A node searches for other nodes with its name.
    rules.write(f"{robot} look", "ingress", LOOKING, [_alive(robot)])
    rules.write(f"{robot} looked", "egress", ["liveliness_token"], [_alive(robot)])
    rules.write(f"{robot} stance_to", "egress", SERVING, stance_keys)
    rules.write(f"{robot} stance_from", "ingress", QUERYING, stance_keys)


def _write_thin(rules: _Rules, robot: str) -> None:
    """Add rules for routers that receive only summary, status and liveliness tokens of a robot."""
    keys = [summary_key(robot), status_key(robot), _alive(robot)]
    rules.write(f"{robot} thin_read", "ingress", SUBSCRIBING, keys)
    rules.write(f"{robot} thin_ask", "ingress", ["query"], [status_key(robot)])
    rules.write(f"{robot} thin_send", "egress", SERVING, keys)


def _write_watching(rules: _Rules) -> None:
    """Add rules for members that may list the live robots and read their status."""
    rules.write("fleet_read", "ingress", SUBSCRIBING, FLEET_KEYS)
    rules.write("fleet_ask", "ingress", ["query"], FLEET_KEYS[:1])
    rules.write("fleet_send", "egress", SERVING, FLEET_KEYS)
