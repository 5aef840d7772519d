"""Zenoh sessions of nodes and clients; closing a session closes everything declared in it."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from transport import zenoh_api
from transport.configuration import (
    DEFAULT_ENDPOINT,
    check_endpoint,
    check_exposure,
    client_configuration,
    node_configuration,
)
from transport.exceptions import ConfigurationError, ConnectionFailed, OperationFailed, SessionClosed
from transport.links import exit_watcher
from transport.links.exit_watcher import Closable
from transport.links.pulse import Pulse
from transport.messages.typestore import warm_up
from transport.security.folder import configured_endpoints, load_configuration, role_folder
from transport.supervision import Failure, supervised

logger = logging.getLogger(__name__)
# Interval between attempts to connect [s].
RETRY_INTERVAL = 0.1

CHECK_LISTEN = (
    "Check: is another node or a Zenoh router running on this port (then stop it, or connect to it instead)? "
    "does the address belong to this machine? with security: are certificate and key in the folder readable, and "
    "is the certificate still valid?"
)
CHECK_CONNECT = (
    "Zenoh reports all causes alike. Check: is the node running and does it listen there? does the "
    "protocol match (tcp without security, tls with it)? with security: is the certificate still valid and from "
    "the same CA as the node's, does the node's certificate name this host? with a password: is it right? "
    "The node's log (RUST_LOG=warn) shows the cause."
)

Configuration = Mapping[str, Any] | str


class Session(AbstractContextManager["Session"]):
    """Open Zenoh session that owns everything declared in it; use it in a `with` block.

    Use `open_node` or `open_client` to open one. Closing the session closes everything declared in it through this
    package. The session is closed at the latest when the main thread ends, so that a script that fails does not hang.

    Attributes:
        endpoints: addresses at which the session listens or to which it connects.
        pulse: sender of periodic messages.
        is_closed: True after `close`.
    """

    def __init__(self, configuration: Configuration, endpoints: tuple[str, ...]) -> None:
        """Open the session in one attempt; see `open_node` and `open_client`."""
        warm_up()
        self._raw: Any = zenoh_api.open_raw(configuration)
        self._lock = threading.RLock()
        self._resources: list[Closable] = []
        self.is_closed = False
        self._cause = "open a new one"
        self.endpoints = endpoints
        self.pulse = Pulse()
        exit_watcher.watch(self)

    def __exit__(self, *error: object) -> None:
        """Close the session."""
        self.close()

    @property
    def raw(self) -> Any:
        """Underlying `zenoh.Session`.

        Raises:
            SessionClosed: the session is closed.
        """
        self.check_open()
        return self._raw

    def check_open(self) -> None:
        """Check that the session is open.

        Raises:
            SessionClosed: the session is closed.
        """
        if self.is_closed:
            raise SessionClosed(f"the Zenoh session is closed; {self._cause}")

    @property
    def zenoh_id(self) -> str:
        """Zenoh id of this session, in hexadecimal digits."""
        return str(self.raw.zid())

    def links(self) -> tuple[str, ...]:
        """Return the remote addresses of all current links; none if the session is closed."""
        return () if self.is_closed else tuple(str(link.dst) for link in self._raw.info.links())

    def own(self, resource: Closable) -> None:
        """Register a resource; `close` closes it before the Zenoh session.

        Raises:
            SessionClosed: the session is already closed.
        """
        with self._lock:
            self.check_open()
            self._resources.append(resource)

    def disown(self, resource: Closable) -> None:
        """Unregister a resource that has been closed; does nothing for others."""
        with self._lock:
            if resource in self._resources:
                self._resources.remove(resource)

    def undeclare(self, *declared: Any) -> None:
        """Undeclare Zenoh entities; does nothing if the session is closed, since closing has undeclared them."""
        if not self._raw.is_closed():
            for entry in declared:
                entry.undeclare()

    def thread(self, name: str, target: Callable[[], Any]) -> threading.Thread:
        """Create, but do not start, a supervised thread; the session is closed if the thread fails for good."""
        return supervised(name, target, on_failure=self._on_failure)

    def _on_failure(self, failure: Failure) -> None:
        if failure.is_final and not self.is_closed:
            self._cause = f"{failure}. Open a new one"
            self.close()

    def attempt(self, what: str, action: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """Call `action` with the further arguments, and convert Zenoh's errors to errors of this package.

        Raises:
            SessionClosed: the session is closed.
            OperationFailed: Zenoh reported another error; the error message begins with `what`.
        """
        try:
            return action(*arguments, **options)
        except zenoh_api.zenoh_error() as error:
            if self.is_closed or self._raw.is_closed():
                raise SessionClosed(f"{what}: the Zenoh session is closed") from error
            raise OperationFailed(f"{what}: {zenoh_api.error_text(error)}") from error

    def close(self) -> None:
        """Close everything declared, newest first, then the session; may be called twice."""
        with self._lock:
            if self.is_closed:
                return
            self.is_closed = True
            resources, self._resources = self._resources[::-1], []
        for resource in resources:
            try:
                resource.close()
            except Exception:
                logger.exception("closing %r failed", resource)
        self.pulse.close()
        try:
            self._raw.close()
        finally:
            exit_watcher.forget(self)


def open_node(
    *,
    listen: str | tuple[str, ...] | None = None,
    connect: str | None = None,
    uplink: str | None = None,
    security: str | Path | None = None,
    allow_insecure: bool = False,
    shared_memory: bool = False,
    timeout: float = 5.0,
) -> Session:
    """Open the session of a perception node.

    Args:
        listen: endpoints at which the node, as a Zenoh router, accepts clients. None = the endpoints in the security
            folder or, without one, the default on this machine.
        connect: endpoint of an external router; the node then does not listen.
        uplink: endpoint of another router to which a listening node also connects, in the background; it reconnects
            after each loss of the link. A message crosses the uplink at most once, however many readers are behind it.
        security: folder of the robot made by `guara security init`, or its subfolder `node`.
        allow_insecure: True = `listen` and `uplink` may reach beyond this machine without security.
        shared_memory: True = Zenoh passes large payloads through /dev/shm between processes of one machine. This saves
            a millisecond per grid, but a client keeps 17 MB and 2 descriptors of every node that dies.
        timeout: time for repeated attempts to connect to an external router [s].

    Raises:
        ConfigurationError: an endpoint is not valid, or is not encrypted although `security` is given; with neither
            `security` nor `allow_insecure`, `listen` or `uplink` reaches beyond this machine; or both `connect` and
            `uplink` are given.
        SecurityError: the security folder is incomplete or unreadable, or others can read its private key.
        ConnectionFailed: the node cannot listen, for example because the port is in use, or cannot connect to the
            external router.
    """
    check_node_links(listen, connect, uplink, security, allow_insecure)
    if connect is not None:
        return open_client(connect, security=security, role="node", shared_memory=shared_memory, timeout=timeout)
    given = (listen,) if isinstance(listen, str) else tuple(listen or ())
    if security is None:
        endpoints = given or (DEFAULT_ENDPOINT,)
        return listen_with(node_configuration(endpoints, uplink=uplink, shared_memory=shared_memory), endpoints)
    folder = role_folder(security, "node")
    configuration = load_configuration(folder, listen=given, uplink=uplink, shared_memory=shared_memory)
    return listen_with(configuration, given or configured_endpoints(folder, "listen"))


def check_node_links(
    listen: str | tuple[str, ...] | None,
    connect: str | None,
    uplink: str | None,
    security: str | Path | None,
    allow_insecure: bool,
) -> None:
    """Check the endpoints of `open_node`, whose arguments these are, without opening a session.

    Raises:
        ConfigurationError: as in `open_node`, without the security folder.
    """
    if connect is not None and uplink is not None:
        raise ConfigurationError(
            f"connect ({connect}) and uplink ({uplink}) are mutually exclusive: a node is the client of one router, or "
            f"its own router with an uplink; give one of them"
        )
    listening = (listen,) if isinstance(listen, str) else tuple(listen or ())
    # Clients of the router at the other end of the uplink can reach this node too.
    given = (connect,) if connect is not None else (*listening, *(() if uplink is None else (uplink,)))
    for endpoint in given:
        check_endpoint(endpoint)
    if security is None and connect is None:
        check_exposure(given, allow_insecure=allow_insecure)


def open_client(
    endpoint: str | None = None,
    *,
    security: str | Path | None = None,
    role: str = "planner",
    shared_memory: bool = False,
    timeout: float = 5.0,
) -> Session:
    """Open the session of a client: a planner, a viewer, the gait controller.

    Args:
        endpoint: endpoint of the node or router. None = the one in the security folder or, without one, the default on
            this machine.
        security: folder of a role made by `guara security init`, such as `DIR/planner`, or `DIR` itself.
        role: role whose folder is used if `security` contains several.
        shared_memory: as in `open_node`.
        timeout: time for repeated attempts to connect [s]; Ctrl-C ends the attempts.

    Raises:
        ConfigurationError: the endpoint is not valid, is not encrypted although `security` is given, or is missing in
            the security folder.
        SecurityError: the security folder is incomplete or unreadable, or others can read its private key.
        ConnectionFailed: there was no connection within `timeout`; the error message lists what to check.
    """
    if security is None:
        target = endpoint or DEFAULT_ENDPOINT
        return connect_with(client_configuration(target, shared_memory=shared_memory), (target,), timeout)
    folder = role_folder(security, role)
    endpoints = (endpoint,) if endpoint is not None else configured_endpoints(folder, "connect")
    if not endpoints:
        raise ConfigurationError(f"{folder} contains no endpoint of a router; give an endpoint, tls/host:port")
    configuration = load_configuration(folder, connect=endpoints[0], shared_memory=shared_memory)
    return connect_with(configuration, endpoints, timeout)


def listen_with(configuration: Configuration, endpoints: tuple[str, ...]) -> Session:
    """Open a listening session from a complete Zenoh configuration; ConnectionFailed if it cannot listen."""
    try:
        return Session(configuration, endpoints)
    except zenoh_api.zenoh_error() as error:
        raise ConnectionFailed(
            f"cannot listen on {', '.join(endpoints)}: {zenoh_api.error_text(error)}. {CHECK_LISTEN}"
        ) from error


def connect_with(configuration: Configuration, endpoints: tuple[str, ...], timeout: float) -> Session:
    """Open a client session from a complete Zenoh configuration; ConnectionFailed if it cannot connect in time."""
    deadline = time.monotonic() + timeout
    while True:
        try:
            return Session(configuration, endpoints)
        except zenoh_api.zenoh_error() as error:
            if time.monotonic() + RETRY_INTERVAL >= deadline:
                raise ConnectionFailed(
                    f"cannot connect to {', '.join(endpoints)} within {timeout:g} s: "
                    f"{zenoh_api.error_text(error)} {CHECK_CONNECT}"
                ) from error
        time.sleep(RETRY_INTERVAL)


class Resource:
    """Base class of objects that are declared in a session and closed with it.

    Attributes:
        is_closed: True after `close`.
    """

    is_closed = False
    # Entity declared in Zenoh.
    _raw: Any

    def __init__(self, session: Session) -> None:
        """Register the object with `session`."""
        self._session = session
        self._close_lock = threading.Lock()
        session.own(self)

    def close(self) -> None:
        """Undeclare the object; may be called twice, from any thread, and after the session was closed."""
        with self._close_lock:
            if self.is_closed:
                return
            self.is_closed = True
        self._session.disown(self)
        self._release()

    def _release(self) -> None:
        """Undeclare and release everything; called at most once."""
        self._session.undeclare(self._raw)
