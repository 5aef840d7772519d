"""Zenoh configurations of nodes, routers and clients: endpoints, leases and queues."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from transport.exceptions import ConfigurationError

# Default endpoint of node and clients: this machine only.
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"

# Time without a message after which a peer counts as dead [ms]; a hung node is then detected within 2.5 s.
LEASE_MS = 2000

# Longest wait for room on a link before a sample of several fragments is dropped for this link [us]; all other readers
# wait meanwhile.
WAIT_BEFORE_DROP_US = 20_000

# The same wait for clients and site routers [us]. It may be longer: a client has a single link, and a robot's planner
# usually runs next to its node, not behind a site router. It includes the time that a busy machine needs to run the
# threads of a hundred links; with a shorter wait, maps sent in bursts were lost between router and planner.
PATIENT_WAIT_US = 100_000

# Length of a link's queue by priority, in batches of 64 KiB (default 2, maximum 16). The grid of a scan, the largest
# piece of a fetched message and most of a map fit into a queue. Therefore a reader that is preempted for a few
# milliseconds usually loses nothing, and a put does not wait.
QUEUES = {"data_high": 16, "data_low": 8, "background": 16}

HIGHEST_PORT = 65535
PROTOCOLS = ("tcp", "tls", "udp", "quic", "ws", "unixsock-stream")

RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}


def check_endpoint(endpoint: str) -> str:
    """Check a Zenoh endpoint, `protocol/address`; return the endpoint.

    Raises:
        ConfigurationError: the protocol is unknown, address or port is missing, or the port is above HIGHEST_PORT.
    """
    protocol, _, address = str(endpoint).partition("/")
    port = address.split("?")[0].rpartition(":")[2]
    is_port = port.isdecimal() and len(port) <= len(str(HIGHEST_PORT)) and int(port) <= HIGHEST_PORT
    if protocol not in PROTOCOLS or not address or not (is_port or protocol == "unixsock-stream"):
        raise ConfigurationError(
            f"endpoint {endpoint!r} is not valid; write protocol/host:port, for example {DEFAULT_ENDPOINT}, "
            f"with one of {', '.join(PROTOCOLS)} and a port of 0 ... {HIGHEST_PORT}"
        )
    return endpoint


def check_tls(endpoint: str, *, allows_quic: bool = False) -> str:
    """Check that an endpoint is encrypted, with TLS or, optionally, QUIC; return the endpoint.

    Raises:
        ConfigurationError: the endpoint is not encrypted or not valid.
    """
    if not check_endpoint(endpoint).startswith(("tls/", "quic/") if allows_quic else "tls/"):
        raise ConfigurationError(f"endpoint {endpoint!r} is not encrypted; write tls/host:port")
    return endpoint


def tls_endpoint(host: str, port: str) -> str:
    """Return the TLS endpoint of a host and port; IPv6 addresses are put in brackets."""
    return f"tls/[{host}]:{port}" if ":" in host and not host.startswith("[") else f"tls/{host}:{port}"


def is_local(endpoint: str) -> bool:
    """Return True if an endpoint can be reached only from this machine.

    Raises:
        ConfigurationError: the endpoint is not valid.
    """
    protocol, _, address = check_endpoint(endpoint).partition("/")
    if protocol == "unixsock-stream":
        return True
    host = address.split("?")[0].rpartition(":")[0].strip("[]")
    if host == "localhost":
        return True
    with suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return False


def check_exposure(endpoints: Sequence[str], *, allow_insecure: bool) -> None:
    """Reject endpoints that other machines can reach, unless allowed explicitly; for sessions without security.

    Raises:
        ConfigurationError: an endpoint is not valid, or other machines can reach it and `allow_insecure` is False.
    """
    for endpoint in endpoints:
        if not (is_local(endpoint) or allow_insecure):
            raise ConfigurationError(
                f"endpoint {endpoint!r} is reachable from other machines and nothing protects it; give a "
                f"security folder, stay on 127.0.0.1, or allow it explicitly (allow_insecure)"
            )


def sending(*, patient: bool = False) -> dict[str, Any]:
    """Return the section `transport/link/tx`: lease, queues, and longest wait before a sample is dropped."""
    drop = {"max_wait_before_drop_fragments": PATIENT_WAIT_US if patient else WAIT_BEFORE_DROP_US}
    return {"lease": LEASE_MS, "queue": {"size": dict(QUEUES), "congestion_control": {"drop": drop}}}


def _base(*, shared_memory: bool, patient: bool = False) -> dict[str, Any]:
    return {
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"link": {"tx": sending(patient=patient)}, "shared_memory": {"enabled": shared_memory}},
    }


def dialling(endpoint: str) -> dict[str, Any]:
    """Return the section `connect` of a router that connects to another router, again whenever the link is lost."""
    return {
        "endpoints": [check_endpoint(endpoint)],
        "timeout_ms": -1,
        "exit_on_failure": False,
        "retry": dict(RETRY),
    }


def node_configuration(
    listen: Sequence[str], *, uplink: str | None = None, shared_memory: bool = True
) -> dict[str, Any]:
    """Return the configuration of a node that is the router of its clients and may connect to another router."""
    return {
        "mode": "router",
        "listen": {"endpoints": [check_endpoint(endpoint) for endpoint in listen]},
        **({} if uplink is None else {"connect": dialling(uplink)}),
        **_base(shared_memory=shared_memory),
    }


def router_configuration(listen: Sequence[str], *, uplink: str | None = None) -> dict[str, Any]:
    """Return the configuration of a site router: as for a node, but with longer waits and without shared memory."""
    return {**node_configuration(listen, uplink=uplink), **_base(shared_memory=False, patient=True)}


def client_configuration(endpoint: str, *, shared_memory: bool = True) -> dict[str, Any]:
    """Return the configuration of a client of one router; the client reconnects when the router returns."""
    return {
        "mode": "client",
        "connect": {"endpoints": [check_endpoint(endpoint)], "timeout_ms": 0, "retry": dict(RETRY)},
        **_base(shared_memory=shared_memory, patient=True),
    }
