"""Check of a security folder: its members try every action at a temporary node or router on this machine."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from transport.configuration import client_configuration
from transport.exceptions import ConnectionFailed, ReceiveTimeout, SecurityError
from transport.keys import FLEET_STATUS, gait_clock_key, scan_key, stance_key, status_key, terrain_key
from transport.links.answerer import Answerer
from transport.links.publisher import Publisher
from transport.links.receiver import NewestReceiver
from transport.links.session import Session, connect_with, listen_with, open_node
from transport.queries.asking import ask
from transport.security.access_rules import FLEET, ROLES, ROUTER
from transport.security.folder import load_configuration, role_folder
from transport.security.members import Members, open_members

# Actions, in the order of the matrix.
ACTIONS = (
    "connect",
    "read grids",
    "read the last grid",
    "see the status",
    "request a scan",
    "publish stance pauses",
    "report the gait's clock",
    "forge grids",
)

# Name of a client without a certificate.
STRANGER = "nobody"

# Actions that should succeed, by role.
WATCHER = ("connect", "see the status")
READER = ("connect", "read grids", "read the last grid", "see the status")
SCANNER = (*READER, "request a scan")
EXPECTED: dict[str, tuple[str, ...]] = {
    "planner": SCANNER,
    "viewer": READER,
    "gait": ("connect", "publish stance pauses", "report the gait's clock"),
    STRANGER: (),
}

# Longest wait for a message that is expected to arrive [s].
WAIT = 2.0
# Time to listen for a message that should not arrive [s]; a forbidden message would arrive within milliseconds.
QUIET = 0.5
# Reply to a scan request.
DONE = b"done"


@dataclass(frozen=True, slots=True)
class Permission:
    """Entry of the permission matrix.

    Attributes:
        role: name of the role or member, or "nobody" for a client without a certificate.
        action: action that was tried.
        allowed: True if the action succeeded.
        expected: True if the action should succeed.
    """

    role: str
    action: str
    allowed: bool
    expected: bool


def _listen(session: Session, key: str, *, latched: bool = False) -> NewestReceiver[str]:
    return NewestReceiver(session, key, lambda payload: payload.decode(), latched=latched)


def _receives(receiver: NewestReceiver[str], text: str, timeout: float) -> bool:
    with suppress(ReceiveTimeout):
        return bool(receiver.wait_for(lambda received: received == text, timeout))
    return False


def _serve(session: Session, key: str, reply: bytes) -> Answerer:
    return Answerer(session, key, lambda query: query.reply(key, reply))


def _is_answered(session: Session, key: str, reply: bytes, timeout: float) -> bool:
    return any(answer.payload == reply for answer in ask(session, key, b"", timeout))


class _Probe:
    """Temporary node of a check: publishes grids and status, answers scan requests, and collects stance pauses."""

    def __init__(self, session: Session, robot: str) -> None:
        self.robot, self.session = robot, session
        self.live = Publisher(session, terrain_key(robot), latched=True)
        self.status = Publisher(session, status_key(robot), latched=False)
        self.stance = _listen(session, stance_key(robot))
        _serve(session, scan_key(robot), DONE)
        self.live.put(b"last")


def check_security(folder: str | Path, *, robot: str | None = None) -> tuple[Permission, ...]:
    """Try every action at a temporary node, as planner, viewer and gait, and without a certificate.

    The temporary node has the folder's own configuration and listens on a free port of this machine; a running node is
    not affected. Routers of this robot, and planner and node of one other robot, are tried too if the folder contains
    them.

    Args:
        folder: folder made by `init_security`, with the folders of all roles.
        robot: instance name; None = the first robot in the folder.

    Returns:
        One entry for each action of each role or member.

    Raises:
        SecurityError: a role's folder is missing, there is no such robot, or it has no planner or viewer left.
        ConnectionFailed: the node does not start with its configuration.
    """
    members, name = _robot_in(folder, robot)
    robot_folder = members.robots[name].folder
    rows = _own_rows(members, name)
    for router in members.routers:
        if name in members.routers[router].robots and router not in members.revoked:
            allowed = SCANNER if members.routers[router].scans else READER
            rows[f"{router}.{ROUTER}"] = (members.root / router, allowed)
    endpoint = _free_endpoint()
    with open_node(listen=endpoint, security=robot_folder / "node", shared_memory=False) as session:
        return _try_all(_Probe(session, name), rows, endpoint, _reader_of(members, name))


def check_router(folder: str | Path, router: str, *, robot: str | None = None) -> tuple[Permission, ...]:
    """Check a router, in the same way as `check_security` checks a node.

    A temporary router with the same configuration runs on a free port of this machine, with a node as its client.

    Args:
        folder: folder made by `init_security`.
        router: name of the router.
        robot: instance name of a robot that the router serves; None = the first.

    Raises:
        SecurityError: there is no such router, it does not serve the robot, or the robot has no planner or viewer left.
        ConnectionFailed: the router does not start with its configuration, or does not accept the node.
    """
    members = open_members(folder)
    if router not in members.routers:
        raise SecurityError(f"{folder} has no router {router!r}; routers: {', '.join(members.routers) or 'none'}")
    served = members.routers[router]
    name = robot or served.robots[0]
    if name not in served.robots:
        raise SecurityError(f"router {router!r} does not serve {name!r}; it serves {', '.join(served.robots)}")
    robot_folder, rows = members.robots[name].folder, _own_rows(members, name)
    if served.uplink and served.uplink not in members.revoked:
        allowed = WATCHER if served.summary_only else SCANNER if served.scans else READER
        rows[f"{served.uplink}.{ROUTER}"] = (members.root / served.uplink, allowed)
    for other, found in members.routers.items():
        if found.uplink == router and other not in members.revoked:
            # A router below is trusted with all keys of the robots that it serves.
            trusted = ("connect", "forge grids") if name in found.robots else ("connect",)
            rows[f"{other}.{ROUTER}"] = (members.root / other, trusted)
    for watcher in members.fleet:
        if watcher not in members.revoked:
            rows[f"{watcher}.{FLEET}"] = (members.root / watcher, WATCHER)
    endpoint = _free_endpoint()
    configuration = load_configuration(members.root / router, listen=[endpoint], local=True)
    with (
        listen_with(configuration, (endpoint,)),
        open_node(connect=endpoint, security=robot_folder / "node", shared_memory=False) as session,
    ):
        return _try_all(_Probe(session, name), rows, endpoint, _reader_of(members, name))


def _robot_in(folder: str | Path, robot: str | None) -> tuple[Members, str]:
    members = open_members(folder)
    if not members.robots:
        role_folder(Path(folder) / "node", "node")
    name = robot or next(iter(members.robots))
    if name not in members.robots:
        raise SecurityError(f"{folder} has no robot {name!r}; robots: {', '.join(members.robots)}")
    for role in ROLES:
        role_folder(members.robots[name].folder / role, role)
    return members, name


def _own_rows(members: Members, robot: str) -> dict[str, tuple[Path | None, tuple[str, ...]]]:
    own = members.robots[robot]
    rows: dict[str, tuple[Path | None, tuple[str, ...]]] = {}
    for role, allowed in EXPECTED.items():
        expected = ("connect",) if role in own.revoked else allowed
        rows[role] = (None, ()) if role == STRANGER else (own.folder / role, expected)
    other = next((other for other in members.robots if other != robot), None)
    if other is not None:
        for role in ("planner", "node"):
            rows[f"{other}.{role}"] = (members.robots[other].folder / role, ("connect",))
    return rows


def _reader_of(members: Members, robot: str) -> Path:
    """Return the folder of a member that would receive a forged grid."""
    own = members.robots[robot]
    roles = {"viewer": "viewer", "planner": "planner", **own.added}
    for name, role in roles.items():
        if "read grids" in EXPECTED.get(role, ()) and name not in own.revoked:
            return own.folder / name
    raise SecurityError(
        f"no planner or viewer of {robot} is left to observe a forged grid; add one with `guara security add`, then "
        "check again"
    )


def _free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tls/localhost:{probe.getsockname()[1]}"


def _try_all(
    node: _Probe, rows: dict[str, tuple[Path | None, tuple[str, ...]]], endpoint: str, reader: Path
) -> tuple[Permission, ...]:
    found: list[Permission] = []
    with _open_role(reader, reader, endpoint) as witness:
        grids = None if witness is None else _listen(witness, terrain_key(node.robot))
        for role, (folder, expected) in rows.items():
            with _open_role(folder, reader, endpoint) as session:
                allowed = set() if session is None else _try_role(session, role, expected, node, grids)
            found += [Permission(role, action, action in allowed, action in expected) for action in ACTIONS]
    return tuple(found)


@contextmanager
def _open_role(folder: Path | None, known: Path, endpoint: str) -> Iterator[Session | None]:
    try:
        if folder is None:
            configuration = client_configuration(endpoint, shared_memory=False)
            configuration["transport"]["link"]["tls"] = {"root_ca_certificate": str(known / "ca.pem")}
            session = connect_with(configuration, (endpoint,), 0.0)
        else:
            text = load_configuration(folder, connect=endpoint, shared_memory=False, local=True)
            session = connect_with(text, (endpoint,), WAIT)
    except ConnectionFailed:
        yield None
        return
    with session:
        yield session


def _try_role(
    session: Session, role: str, expected: tuple[str, ...], node: _Probe, witness: NewestReceiver[str] | None
) -> set[str]:
    allowed = {"connect"}
    wait = {action: WAIT if action in expected else QUIET for action in ACTIONS}
    key, clock_key = terrain_key(node.robot), gait_clock_key(node.robot)
    live, last = _listen(session, key), _listen(session, key, latched=True)
    status = _listen(session, FLEET_STATUS if role.endswith(f".{FLEET}") else status_key(node.robot))
    if _receives(last, "last", wait["read grids"]):
        allowed.add("read the last grid")
    deadline = time.monotonic() + wait["see the status"]
    awaited = {"read grids", "see the status"} & set(expected) or {"read grids"}
    while time.monotonic() < deadline and not awaited <= allowed:
        node.live.put(f"live {role}".encode())
        node.status.put(f"status {role}".encode())
        if _receives(live, f"live {role}", 0.1):
            allowed.add("read grids")
        if _receives(status, f"status {role}", 0.1):
            allowed.add("see the status")
    node.live.put(b"last")
    if _is_answered(session, scan_key(node.robot), DONE, WAIT):
        allowed.add("request a scan")
    reply = f"clock of {role}".encode()
    clock = _serve(session, clock_key, reply)
    deadline = time.monotonic() + wait["report the gait's clock"]
    while time.monotonic() < deadline and "report the gait's clock" not in allowed:
        if _is_answered(node.session, clock_key, reply, QUIET):
            allowed.add("report the gait's clock")
    clock.close()
    stance, forged = f"stance of {role}", f"forged by {role}"
    session.raw.put(stance_key(node.robot), stance.encode())
    session.raw.put(key, forged.encode())
    if _receives(node.stance, stance, wait["publish stance pauses"]):
        allowed.add("publish stance pauses")
    if witness is not None and _receives(witness, forged, wait["forge grids"]):
        allowed.add("forge grids")
    return allowed


def format_matrix(permissions: tuple[Permission, ...]) -> str:
    """Format the matrix as text, with a row per role and a column per action; `!` marks unexpected results."""
    rows = {"role": list(ACTIONS)}
    for cell in permissions:
        mark = ("yes" if cell.allowed else "no") + ("" if cell.allowed == cell.expected else " !")
        rows.setdefault(cell.role, []).append(f"{mark:<{len(cell.action)}}")
    first = max(map(len, rows))
    return "\n".join("  ".join([f"{role:<{first}}", *cells]).rstrip() for role, cells in rows.items())
