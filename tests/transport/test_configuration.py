"""Tests of the Zenoh configurations."""

import pytest

import transport
from transport import ConfigurationError
from transport.configuration import (
    DEFAULT_ENDPOINT,
    QUEUES,
    check_endpoint,
    check_exposure,
    client_configuration,
    is_local,
    node_configuration,
)
from transport.links.last_message import MAXIMUM_PIECE


@pytest.mark.parametrize(
    "endpoint",
    [
        "",
        "tcp",
        "tcp/",
        "tcp/host",
        "foo/1.2.3.4:5",
        "127.0.0.1:7447",
        "tcp/host:65536",
        "tcp/host:" + "9" * 5000,
        None,
        7447,
    ],
)
def test_an_endpoint_that_zenoh_would_not_take_is_refused(endpoint: str) -> None:
    """The message shows how to write one."""
    with pytest.raises(ConfigurationError, match=r"protocol/host:port.*tcp/127\.0\.0\.1:7447"):
        check_endpoint(endpoint)


@pytest.mark.parametrize(
    ("endpoint", "local"),
    [
        ("tcp/127.0.0.1:7447", True),
        ("tcp/127.9.9.9:1", True),
        ("tcp/localhost:1", True),
        ("tls/[::1]:1", True),
        ("unixsock-stream//tmp/a", True),
        ("tcp/0.0.0.0:7447", False),
        ("tcp/[::]:7447", False),
        ("tcp/192.168.1.2:7447", False),
        ("tcp/localhost.example.org:1", False),
        ("tcp/robot:7447", False),
    ],
)
def test_local_endpoints_are_distinguished_from_open_ones(endpoint: str, local: bool) -> None:
    """Only what cannot be reached from outside counts as local."""
    assert is_local(endpoint) is local


def test_open_port_without_security_is_refused_unless_asked_for() -> None:
    """Binding beyond this machine must be said explicitly."""
    with pytest.raises(ConfigurationError, match="nothing protects it"):
        check_exposure(["tcp/127.0.0.1:1", "tcp/0.0.0.0:7447"], allow_insecure=False)
    check_exposure(["tcp/0.0.0.0:7447"], allow_insecure=True)


def test_nobody_is_searched_for_and_hangs_are_noticed() -> None:
    """Scouting and gossip are off, and the lease is short, in every configuration."""
    for configuration in (node_configuration(["tcp/127.0.0.1:1"]), client_configuration("tcp/127.0.0.1:1")):
        assert configuration["scouting"] == {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
        assert configuration["transport"]["link"]["tx"]["lease"] <= 2000


def test_a_grid_and_a_piece_fit_into_the_queue_of_a_link(peer) -> None:
    """A put of the grid of a scan waits for no reader, and no piece that is asked for is too large for its queue."""
    # A batch of Zenoh carries 64 KiB at most, its own headers included.
    batch = 60_000
    assert len(transport.encode_terrain(peer.make_terrain(shape=(108, 90)))) < QUEUES["data_low"] * batch
    assert MAXIMUM_PIECE < QUEUES["data_high"] * batch
    for configuration in (node_configuration([DEFAULT_ENDPOINT]), client_configuration(DEFAULT_ENDPOINT)):
        assert configuration["transport"]["link"]["tx"]["queue"]["size"] == QUEUES
