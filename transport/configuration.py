"""Zenoh configurations of nodes, routers and clients: endpoints, leases and queues."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from typing import Any

from transport.exceptions import ConfigurationError

# Where the node listens and clients connect unless configured otherwise: this machine only.
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"

# [ms] A silent side is taken as dead after this time; a hung node is noticed in under 2.5 s.
LEASE_MS = 2000

# [us] A sample that a link cannot take within this time is dropped for that link: the healthy readers wait as long.
WAIT_BEFORE_DROP_US = 20_000

# [us] The same where no healthy reader waits for a slow one for long: at a client, which has one link, and at a router
# of a site, whose robots have their planners with them. There a map is given the time that a busy machine takes to
# run the threads of a hundred links; below it maps of bursts were lost on the link from router to planner.
PATIENT_WAIT_US = 100_000

# Batches of 64 KiB that wait for a link, by priority (Zenoh's default is 2, the most it takes 16): the grid of a scan
# fits whole, so does the largest piece of one that is asked for, and most of a map. A reader on a busy machine that
# does not run for some milliseconds then loses nothing, and a put waits for nobody.
QUEUES = {"data_high": 16, "data_low": 8, "background": 16}

PROTOCOLS = ("tcp", "tls", "udp", "quic", "ws", "unixsock-stream")

RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}


def check_endpoint(endpoint: str) -> str:
    """`endpoint` if it is valid for Zenoh, `protocol/address`.

    Raises:
        ConfigurationError: unknown protocol, no address, or no port where one is needed.
    """
    protocol, _, address = endpoint.partition("/")
    has_port = protocol == "unixsock-stream" or address.split("?")[0].rpartition(":")[2].isdigit()
    if protocol not in PROTOCOLS or not address or not has_port:
        raise ConfigurationError(
            f"endpoint {endpoint!r} is not valid; write protocol/host:port, for example {DEFAULT_ENDPOINT}, "
            f"with one of {', '.join(PROTOCOLS)}"
        )
    return endpoint


def check_tls(endpoint: str, *, allows_quic: bool = False) -> str:
    """`endpoint` if it is encrypted: by TLS, or also by QUIC.

    Raises:
        ConfigurationError: it is not.
    """
    if not check_endpoint(endpoint).startswith(("tls/", "quic/") if allows_quic else "tls/"):
        raise ConfigurationError(f"endpoint {endpoint!r} is not encrypted; write tls/host:port")
    return endpoint


def tls_endpoint(host: str, port: str) -> str:
    """TLS endpoint of a host; an IPv6 address is put into brackets."""
    return f"tls/[{host}]:{port}" if ":" in host and not host.startswith("[") else f"tls/{host}:{port}"


def is_local(endpoint: str) -> bool:
    """Check whether an endpoint can be reached from this machine only."""
    protocol, _, address = check_endpoint(endpoint).partition("/")
    if protocol == "unixsock-stream":
        return True
    host = address.split("?")[0].rpartition(":")[0].strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_exposure(endpoints: Sequence[str], *, allow_insecure: bool) -> None:
    """Refuse endpoints that other machines can reach without security, unless explicitly allowed.

    Raises:
        ConfigurationError: an endpoint is reachable from outside and nothing protects it.
    """
    for endpoint in endpoints:
        if not (is_local(endpoint) or allow_insecure):
            raise ConfigurationError(
                f"endpoint {endpoint!r} is reachable from other machines and nothing protects it; give a "
                f"security folder, stay on 127.0.0.1, or allow it explicitly (allow_insecure)"
            )


def sending(*, patient: bool = False) -> dict[str, Any]:
    """The `transport/link/tx` section: lease, queues, and the wait before a sample is dropped."""
    drop = {"max_wait_before_drop_fragments": PATIENT_WAIT_US if patient else WAIT_BEFORE_DROP_US}
    return {"lease": LEASE_MS, "queue": {"size": dict(QUEUES), "congestion_control": {"drop": drop}}}


def _base(*, shared_memory: bool, patient: bool = False) -> dict[str, Any]:
    return {
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"link": {"tx": sending(patient=patient)}, "shared_memory": {"enabled": shared_memory}},
    }


def dialling(endpoint: str) -> dict[str, Any]:
    """The `connect` section of a router that dials another one and reconnects when the link is lost."""
    return {
        "endpoints": [check_endpoint(endpoint)],
        "timeout_ms": -1,
        "exit_on_failure": False,
        "retry": dict(RETRY),
    }


def node_configuration(
    listen: Sequence[str], *, uplink: str | None = None, shared_memory: bool = True
) -> dict[str, Any]:
    """Configuration of a node that is itself the router that clients connect to, and may dial a further router."""
    return {
        "mode": "router",
        "listen": {"endpoints": [check_endpoint(endpoint) for endpoint in listen]},
        **({} if uplink is None else {"connect": dialling(uplink)}),
        **_base(shared_memory=shared_memory),
    }


def router_configuration(listen: Sequence[str], *, uplink: str | None = None) -> dict[str, Any]:
    """Configuration of a site router: that of a node, with a longer wait before a grid is dropped for a link."""
    return {**node_configuration(listen, uplink=uplink), **_base(shared_memory=False, patient=True)}


def client_configuration(endpoint: str, *, shared_memory: bool = True) -> dict[str, Any]:
    """Configuration of a client of one router; it reconnects by itself when the router comes back."""
    return {
        "mode": "client",
        "connect": {"endpoints": [check_endpoint(endpoint)], "timeout_ms": 0, "retry": dict(RETRY)},
        **_base(shared_memory=shared_memory, patient=True),
    }
