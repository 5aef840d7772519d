"""Tries out what each role of a security folder may do, against a node of its own on this machine."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from transport import zenoh_api
from transport.access_rules import ROLES
from transport.configuration import client_configuration
from transport.exceptions import ConnectionFailed
from transport.fetcher import Fetcher
from transport.keys import check_name, scan_key, stance_key, terrain_key
from transport.publisher import Publisher
from transport.security import configured_robot, role_folder
from transport.session import Session, connect_with, open_client, open_node

# What is tried, in the order of the matrix.
ACTIONS = (
    "connect",
    "read grids",
    "read the last grid",
    "request a scan",
    "publish stance pauses",
    "forge grids",
)

# The row of a client without certificate.
STRANGER = "nobody"

# What each role is meant to be allowed.
EXPECTED = {
    "planner": ("connect", "read grids", "read the last grid", "request a scan"),
    "viewer": ("connect", "read grids", "read the last grid"),
    "gait": ("connect", "publish stance pauses"),
    STRANGER: (),
}

# [s] For what should arrive.
WAIT = 2.0
# [s] For what should not arrive; far above the milliseconds that it would take.
QUIET = 0.5


@dataclass(frozen=True, slots=True)
class Permission:
    """One cell of the matrix.

    Attributes:
        role: role, or "nobody".
        action: what was tried.
        allowed: whether it worked.
        expected: whether it was meant to.
    """

    role: str
    action: str
    allowed: bool
    expected: bool


class _Ear:
    """Notes the texts that arrive on one key."""

    def __init__(self, session: Session, key: str, *, latched: bool = False) -> None:
        self._texts: set[str] = set()
        self._changed = threading.Condition()
        # Kept, because Zenoh ends a subscription with its object.
        self._raw: Any = (
            Fetcher(session, key, self._add, lambda _: None)
            if latched
            else zenoh_api.declare_subscriber(session.raw, key, self._note)
        )

    def _note(self, sample: Any) -> None:
        self._add(sample.payload.to_bytes())

    def _add(self, payload: bytes) -> None:
        with self._changed:
            self._texts.add(payload.decode())
            self._changed.notify_all()

    def hears(self, text: str, timeout: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: text in self._texts, timeout)


class _Probe:
    """A node for the test: it publishes, serves a queryable, and notes what comes in."""

    def __init__(self, session: Session, robot: str) -> None:
        self.robot = robot
        self.live = Publisher(session, terrain_key(robot), latched=True)
        self.stance = _Ear(session, stance_key(robot))
        self._raw: Any = zenoh_api.declare_queryable(session.raw, scan_key(robot), self._reply)
        self.live.put(b"last")

    def _reply(self, query: Any) -> None:
        query.reply(scan_key(self.robot), b"done")
        query.drop()


def check_security(folder: str | Path, *, robot: str | None = None) -> tuple[Permission, ...]:
    """Connect as each role, and as nobody, and try every action.

    A node with the folder's own configuration is opened on a free port of this machine for the time of the
    check; a running node is not touched.

    Args:
        folder: made by `init_security`, with the folders of all roles.
        robot: instance name; None takes the one for which the folder was made.

    Returns:
        One entry per role and action.

    Raises:
        SecurityError: a role's folder is missing.
        ConnectionFailed: the node does not start with its certificate.
    """
    for role in ROLES:
        role_folder(Path(folder) / role, role)
    name = check_name(robot or configured_robot(Path(folder) / "node"))
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tls/localhost:{probe.getsockname()[1]}"
    found: list[Permission] = []
    with open_node(listen=endpoint, security=Path(folder) / "node", shared_memory=False) as session:
        node = _Probe(session, name)
        with open_client(endpoint, security=Path(folder) / "viewer", shared_memory=False) as witness:
            witness_ear = _Ear(witness, terrain_key(name))
            for role in EXPECTED:
                allowed = _try_role(Path(folder), role, endpoint, node, witness_ear)
                found += [Permission(role, action, action in allowed, action in EXPECTED[role]) for action in ACTIONS]
    return tuple(found)


@contextmanager
def _open_role(folder: Path, role: str, endpoint: str) -> Iterator[Session | None]:
    try:
        if role == STRANGER:
            configuration = client_configuration(endpoint, shared_memory=False)
            tls = {"root_ca_certificate": str(folder / "node" / "ca.pem")}
            configuration["transport"]["link"]["tls"] = tls
            session = connect_with(configuration, (endpoint,), 0.0)
        else:
            session = open_client(endpoint, security=folder / role, shared_memory=False, timeout=WAIT)
    except ConnectionFailed:
        yield None
        return
    with session:
        yield session


def _try_role(folder: Path, role: str, endpoint: str, node: _Probe, witness: _Ear) -> set[str]:
    with _open_role(folder, role, endpoint) as session:
        if session is None:
            return set()
        allowed = {"connect"}
        key = terrain_key(node.robot)
        patience = WAIT if role in ("planner", "viewer") else QUIET
        live, last = _Ear(session, key), _Ear(session, key, latched=True)
        if last.hears("last", patience):
            allowed.add("read the last grid")
        deadline = time.monotonic() + patience
        while time.monotonic() < deadline and "read grids" not in allowed:
            node.live.put(f"live {role}".encode())
            if live.hears(f"live {role}", 0.1):
                allowed.add("read grids")
        node.live.put(b"last")
        if _is_answered(session, node.robot):
            allowed.add("request a scan")
        stance, forged = f"stance of {role}", f"forged by {role}"
        session.raw.put(stance_key(node.robot), stance.encode())
        session.raw.put(key, forged.encode())
        if node.stance.hears(stance, WAIT if role == "gait" else QUIET):
            allowed.add("publish stance pauses")
        if witness.hears(forged, QUIET):
            allowed.add("forge grids")
        return allowed


def _is_answered(session: Session, robot: str) -> bool:
    finished = threading.Event()
    replies: list[bytes | None] = []
    zenoh_api.get_replies(session.raw, scan_key(robot), b"", WAIT, lambda reply, _: replies.append(reply), finished.set)
    finished.wait(WAIT + QUIET)
    return b"done" in replies


def format_matrix(permissions: tuple[Permission, ...]) -> str:
    """The matrix as text: a row per role, a column per action; `!` marks what is not as it should be."""
    roles = list(dict.fromkeys(permission.role for permission in permissions))
    actions = list(dict.fromkeys(permission.action for permission in permissions))
    cells = {(permission.role, permission.action): permission for permission in permissions}
    first = max(len(role) for role in [*roles, "role"])
    lines = ["  ".join([f"{'role':<{first}}", *actions])]
    for role in roles:
        row = [f"{role:<{first}}"]
        for action in actions:
            cell = cells[role, action]
            mark = ("yes" if cell.allowed else "no") + ("" if cell.allowed == cell.expected else " !")
            row.append(f"{mark:<{len(action)}}")
        lines.append("  ".join(row).rstrip())
    return "\n".join(lines)
