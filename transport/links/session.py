"""Zenoh sessions of nodes and clients, which close everything declared in them."""

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
    check_exposure,
    client_configuration,
    node_configuration,
)
from transport.exceptions import ConfigurationError, ConnectionFailed, SessionClosed, TransportError
from transport.links import exit_watcher
from transport.links.exit_watcher import Closable
from transport.links.pulse import Pulse
from transport.messages.typestore import warm_up
from transport.security.folder import configured_endpoints, load_configuration, role_folder
from transport.supervision import Failure, supervised

logger = logging.getLogger(__name__)
# Interval of attempts to connect [s]; short, so that Ctrl-C takes effect immediately.
RETRY_INTERVAL = 0.1

CHECK_LISTEN = (
    "Check: is another node or a Zenoh router running on this port (then stop it, or connect to it instead)? "
    "is the address one of this machine? with security: are certificate and key in the folder readable and "
    "in date?"
)
CHECK_CONNECT = (
    "Zenoh reports all causes alike. Check: is the node running and does it listen there? does the "
    "protocol match (tcp without security, tls with it)? with security: is the certificate in date and of "
    "the same CA as the node's, does the node's certificate name this host? with a password: is it right? "
    "The node's log (RUST_LOG=warn) shows the cause."
)

Configuration = Mapping[str, Any] | str


class Session(AbstractContextManager["Session"]):
    """Open Zenoh session with everything declared in it; use it in a `with` block.

    Made by `open_node` or `open_client`. Everything declared through this package is closed with it, at the latest when
    the main thread ends, so that a script that crashes does not hang.

    Attributes:
        endpoints: addresses at which it listens or to which it connects.
        pulse: sender of periodic messages.
        is_closed: True after `close`.
    """

    def __init__(self, configuration: Configuration, endpoints: tuple[str, ...]) -> None:
        """Open the session, without retries; see `open_node` and `open_client`."""
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
        """Close."""
        self.close()

    @property
    def raw(self) -> Any:
        """The Zenoh session.

        Raises:
            SessionClosed: the session is closed.
        """
        self._check_open()
        return self._raw

    def _check_open(self) -> None:
        if self.is_closed:
            raise SessionClosed(f"the Zenoh session is closed; {self._cause}")

    @property
    def zenoh_id(self) -> str:
        """Hexadecimal Zenoh id of this session."""
        return str(self.raw.zid())

    def links(self) -> tuple[str, ...]:
        """Remote addresses of all current links."""
        return () if self.is_closed else tuple(str(link.dst) for link in self._raw.info.links())

    def own(self, resource: Closable) -> None:
        """Close `resource` with this session, before the session itself.

        Raises:
            SessionClosed: the session is closed already.
        """
        with self._lock:
            self._check_open()
            self._resources.append(resource)

    def disown(self, resource: Closable) -> None:
        """Forget a resource that has been closed."""
        with self._lock:
            if resource in self._resources:
                self._resources.remove(resource)

    def undeclare(self, *declared: Any) -> None:
        """Undeclare Zenoh entities, unless the session is closed, which undeclares them too."""
        if not self._raw.is_closed():
            for entry in declared:
                entry.undeclare()

    def thread(self, name: str, target: Callable[[], Any]) -> threading.Thread:
        """Make a supervised thread, not started; if it fails for good, the session closes and later calls raise."""
        return supervised(name, target, on_failure=self._on_failure)

    def _on_failure(self, failure: Failure) -> None:
        if failure.is_final and not self.is_closed:
            self._cause = f"{failure}. Open a new one"
            self.close()

    def attempt(self, action: Callable[[], Any], what: str) -> Any:
        """Call Zenoh and convert its errors into errors of this package.

        Raises:
            SessionClosed: the session is closed.
            TransportError: Zenoh reported an error; the message begins with `what`.
        """
        try:
            return action()
        except zenoh_api.zenoh_error() as error:
            if self.is_closed or self._raw.is_closed():
                raise SessionClosed(f"{what}: the Zenoh session is closed") from error
            raise TransportError(f"{what}: {zenoh_api.error_text(error)}") from error

    def close(self) -> None:
        """Close everything declared, newest first, then the session; safe to call twice."""
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
    """Open the session of a node that publishes.

    Args:
        listen: endpoints for clients; the node is their Zenoh router. None = this machine only, or the endpoints of the
            security folder.
        connect: endpoint of an external router; the node then does not listen.
        uplink: endpoint of another router that the node connects to besides listening, with reconnection; does not
            wait for it. Every message is sent over it once, however many readers are behind it.
        security: folder made by `guara security init`, or its folder `node`.
        allow_insecure: allow endpoints or an uplink beyond this machine without security.
        shared_memory: let Zenoh pass large payloads through /dev/shm between processes of one machine. Saves a
            millisecond per grid, but leaks 17 MB and 2 descriptors for each process that dies.
        timeout: time to wait for an external router [s].

    Raises:
        ConfigurationError: an endpoint is not valid, or open to other machines without security; both `connect` and
            `uplink` are given.
        SecurityError: the security folder is incomplete.
        ConnectionFailed: the port is in use, or the external router does not respond.
    """
    if connect is not None and uplink is not None:
        raise ConfigurationError(
            f"connect ({connect}) and uplink ({uplink}) exclude each other: a node is the client of one router, or "
            f"its own router with an uplink; give one of them"
        )
    if connect is not None:
        return open_client(connect, security=security, role="node", shared_memory=shared_memory, timeout=timeout)
    given = (listen,) if isinstance(listen, str) else tuple(listen or ())
    if security is None:
        endpoints = given or (DEFAULT_ENDPOINT,)
        # Clients of the router at the other end of an uplink can reach this node too.
        check_exposure((*endpoints, *(() if uplink is None else (uplink,))), allow_insecure=allow_insecure)
        return listen_with(node_configuration(endpoints, uplink=uplink, shared_memory=shared_memory), endpoints)
    folder = role_folder(security, "node")
    configuration = load_configuration(folder, listen=given, uplink=uplink, shared_memory=shared_memory)
    return listen_with(configuration, given or configured_endpoints(folder, "listen"))


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
        endpoint: endpoint of the node or router. None = the default on this machine, or the one in the security folder.
        security: folder of a role, such as `DIR/planner`, or `DIR` itself, made by `guara security init`.
        role: role whose folder is used if `security` has several.
        shared_memory: as in `open_node`.
        timeout: time for attempts to connect [s]; Ctrl-C ends the wait.

    Raises:
        ConfigurationError: the endpoint is not valid, or not encrypted although a security folder is given.
        SecurityError: the security folder is incomplete.
        ConnectionFailed: no connection within `timeout`; the message lists what to check.
    """
    if security is None:
        target = endpoint or DEFAULT_ENDPOINT
        return connect_with(client_configuration(target, shared_memory=shared_memory), (target,), timeout)
    folder = role_folder(security, role)
    endpoints = (endpoint,) if endpoint is not None else configured_endpoints(folder, "connect")
    if not endpoints:
        raise ConfigurationError(f"{folder} names no router to connect to; give an endpoint, tls/host:port")
    configuration = load_configuration(folder, connect=endpoints[0], shared_memory=shared_memory)
    return connect_with(configuration, endpoints, timeout)


def listen_with(configuration: Configuration, endpoints: tuple[str, ...]) -> Session:
    """Open a session that listens, from a complete Zenoh configuration; errors as in `open_node`."""
    try:
        return Session(configuration, endpoints)
    except zenoh_api.zenoh_error() as error:
        raise ConnectionFailed(
            f"cannot listen on {', '.join(endpoints)}: {zenoh_api.error_text(error)}. {CHECK_LISTEN}"
        ) from error


def connect_with(configuration: Configuration, endpoints: tuple[str, ...], timeout: float) -> Session:
    """Open a client's session from a complete Zenoh configuration; errors as in `open_client`."""
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
    # Entity declared by Zenoh.
    _raw: Any

    def __init__(self, session: Session) -> None:
        """Register with `session`."""
        self._session = session
        self._close_lock = threading.Lock()
        session.own(self)

    def close(self) -> None:
        """Undeclare it; safe to call twice, from any thread, and after the session was closed."""
        with self._close_lock:
            if self.is_closed:
                return
            self.is_closed = True
        self._session.disown(self)
        self._release()

    def _release(self) -> None:
        """Undeclare and release everything; called once."""
        self._session.undeclare(self._raw)
