"""Uniqueness of a robot's name on a router: a second node waits for the first to stop, and fails if it does not."""

from __future__ import annotations

import logging
import re
import time
import uuid
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from transport.configuration import DEFAULT_ENDPOINT
from transport.exceptions import ConnectionFailed, NameTaken, TransportError
from transport.keys import DEFAULT_ROBOT, NODE_ROLE, alive_key, claim_key, run_key
from transport.links.liveliness import AliveToken, TokenWatcher, alive_keys
from transport.links.session import Session, open_client, open_node
from transport.messages.status_message import StatusItem
from transport.messages.terrain_message import Health
from transport.security.folder import configured_endpoints, role_folder

logger = logging.getLogger(__name__)
# Longest wait for another node to stop [s]. A killed node disappears immediately, a hung one within 2.5 s; the rest
# is a margin for a busy machine.
NAME_TIMEOUT = 15.0
# Interval of checks while waiting [s].
POLL = 0.25
# Timeout for connecting to the node that uses the port, in order to notify it [s].
KNOCK_TIMEOUT = 0.5
TWO_NODES = (
    "another node named {} is running behind an uplink: readers there accept the grids of only one of the two. Give "
    "one of them another name"
)
WAITING_NODE = (
    "another node is waiting for the name {}: only one node may use it. Stop one of the two, or give it another name"
)
ANYWHERE = re.compile(r"/(0\.0\.0\.0|\[::\]):")


def claim_name(session: Session, robot: str, *, timeout: float = NAME_TIMEOUT) -> AliveToken:
    """Wait until no other node uses the name, and reserve the name.

    Args:
        session: open session of the node.
        robot: instance name.
        timeout: longest wait for another node to stop [s].

    Returns:
        Token that claims the name. Close it after declaring the node's own tokens.

    Raises:
        NameTaken: after `timeout`, another node still uses the name, or waits for it and takes precedence.
        KeyNameError: the name cannot be part of a key.
        SessionClosed: the session is closed.
    """
    mine = uuid.uuid4().hex
    claim = AliveToken(session, claim_key(robot, mine))
    deadline, is_reported = time.monotonic() + timeout, False
    while True:
        others = alive_keys(session, alive_key(robot)) + alive_keys(session, run_key(robot))
        claims = [key.rpartition("/")[2] for key in alive_keys(session, claim_key(robot))]
        if not others and min([mine, *claims]) == mine:
            return claim
        if not is_reported:
            text = "another node uses or waits for the name %r; waiting up to %g s for it to stop"
            logger.warning(text, robot, timeout)
            is_reported = True
        if time.monotonic() > deadline:
            claim.close()
            raise NameTaken(
                f"after {timeout:g} s, another node on this router still uses or waits for the name {robot!r}; "
                "planners would receive the grids of both nodes. Stop it, or give this one another name (--name)"
            )
        time.sleep(POLL)


def open_only_node(
    *,
    robot: str = DEFAULT_ROBOT,
    listen: str | None = None,
    connect: str | None = None,
    uplink: str | None = None,
    security: str | Path | None = None,
    allow_insecure: bool = False,
    timeout: float = NAME_TIMEOUT,
    is_stopped: Callable[[], bool] = lambda: False,
) -> Session:
    """Open a session as `open_node` does; if it cannot listen, notify the node that uses the port, and try again.

    Args:
        robot: instance name; if the other node has the same name, its status reports that a node is waiting for it.
        listen, connect, uplink, security, allow_insecure: as in `open_node`.
        timeout: longest wait for the port to become free [s].
        is_stopped: returns True to end the wait.

    Raises:
        ConnectionFailed: the node still cannot listen after `timeout`, or when `is_stopped` returns True; or it cannot
            connect to the router given by `connect`.
        ConfigurationError, SecurityError: as in `open_node`.
    """
    deadline = time.monotonic() + timeout
    with ExitStack() as stack:
        has_knocked = False
        while True:
            try:
                return open_node(
                    listen=listen, connect=connect, uplink=uplink, security=security, allow_insecure=allow_insecure
                )
            except ConnectionFailed as error:
                if connect is not None or is_stopped():
                    raise
                if time.monotonic() > deadline:
                    raise ConnectionFailed(f"{error} (waited {timeout:g} s for the port to become free)") from error
                if not has_knocked:
                    has_knocked = True
                    logger.warning(
                        "cannot listen yet; waiting up to %g s for the port to become free: %s", timeout, error
                    )
                    _knock(stack, listen, security, robot)
            time.sleep(POLL)


def _knock(stack: ExitStack, listen: str | None, security: str | Path | None, robot: str) -> None:
    """Notify the node that uses the port that another node is waiting; without access, do nothing."""
    try:
        folder = None if security is None else role_folder(security, NODE_ROLE)
        own = (DEFAULT_ENDPOINT,) if folder is None else configured_endpoints(folder, "listen")
        # If the node listens on all interfaces, connect to localhost, which its certificate names.
        endpoint = ANYWHERE.sub("/localhost:", listen or own[0])
        session = stack.enter_context(open_client(endpoint, security=folder, timeout=KNOCK_TIMEOUT))
        AliveToken(session, claim_key(robot, uuid.uuid4().hex))
    except (TransportError, IndexError) as error:
        logger.debug("no node to notify: %s", error)


class NameWatch:
    """Monitor of other nodes that use or claim a robot's name."""

    def __init__(self, session: Session, robot: str, run: str, on_change: Callable[[], None]) -> None:
        """Start to monitor the name.

        Args:
            session: open session of the node.
            robot: instance name.
            run: identity of the node's own run.
            on_change: called on Zenoh's thread when a node that uses or claims the name, including this one, appears
                or disappears; must not block.
        """
        self._robot, self._run = robot, run
        self._claims = TokenWatcher(session, claim_key(robot), lambda _: on_change())
        # Another node may appear later, for example over an uplink that was down when the name was claimed.
        self._runs = TokenWatcher(session, run_key(robot), lambda _: on_change())

    def items(self) -> list[StatusItem]:
        """Return a status item about another node that uses or claims the name, or none."""
        if self._runs.names - {self._run}:
            level, text = Health.ERROR, TWO_NODES
        elif self._claims.names:
            level, text = Health.WARN, WAITING_NODE
        else:
            return []
        message = text.format(repr(self._robot))
        return [StatusItem(name="name", level=level, message=message, hardware_id=self._robot)]

    def close(self) -> None:
        """Stop monitoring; may be called twice."""
        self._claims.close()
        self._runs.close()
