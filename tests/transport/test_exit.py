"""Tests that no script hangs: however a planner's or a node's program ends, it ends."""

import signal

import pytest


@pytest.mark.parametrize(
    ("how", "code"),
    [
        ("plain", 0),
        ("subscribed", 0),
        ("raise", 1),
        ("stuck", 0),
        *(
            pytest.param(*case, marks=pytest.mark.heavy)
            for case in (("sys_exit", 5), ("exit_in_callback", 0), ("thread", 0))
        ),
    ],
)
def test_a_script_that_closes_nothing_ends(start_program, shared_node, how: str, code: int) -> None:
    """With an open session, a subscription and a callback, the interpreter still ends, with its own code."""
    node, endpoint = shared_node
    node.tell("publish 1")
    script = start_program("exit", endpoint, how)
    assert script.wait() == code
    if how == "raise":
        assert any("crashed as asked" in line for line in script.errors)


@pytest.mark.parametrize("how", ["wait_grid", "wait_scan", "wait_connect"])
def test_ctrl_c_ends_every_wait(start_program, shared_node, how: str) -> None:
    """A keyboard interrupt gets through while waiting for a grid, a scan or a connection."""
    node, endpoint = shared_node
    node.tell("publish 1")
    script = start_program("exit", endpoint, how)
    if how == "wait_scan":
        node.expect("scanning")
    script.send(signal.SIGINT)
    assert script.wait() != 0
    assert any("KeyboardInterrupt" in line for line in script.errors), script.errors


def test_a_node_that_crashes_ends(start_program, endpoint: str) -> None:
    """An uncaught error in the node's main thread ends its process although it serves and publishes."""
    node = start_program("node", endpoint)
    node.tell("publish 1")
    node.tell("crash")
    assert node.wait() == 1


def test_sigterm_ends_a_node(start_program, endpoint: str) -> None:
    """The usual way to stop a service works."""
    node = start_program("node", endpoint)
    node.send(signal.SIGTERM)
    assert node.wait() == -signal.SIGTERM
