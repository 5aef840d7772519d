"""Robots found by sign of life and status: real nodes in other processes, and one that answers for another."""

import math
from collections.abc import Callable
from typing import Any

import pytest

import transport
from tests.ports import free_endpoint
from transport import Health, zenoh_api
from transport.fleet import robot_states
from transport.keys import alive_key, status_key
from transport.links.liveliness import AliveToken
from transport.messages.status_message import STATUS_NAME, Status, StatusItem, encode_status


@pytest.mark.slow
def test_all_that_live_are_reported_with_step_age_health_and_links(start, endpoint: str, eventually) -> None:
    """A robot that is a client of the router, one with an uplink, one that shows life and nothing more; one killed."""
    start("router", endpoint)
    own = free_endpoint()
    start("node", endpoint, "connect", "", "ada").tell("publish 4")
    start("node", own, "listen", "", "rex", endpoint)
    gone = start("node", endpoint, "connect", "", "bob")
    with transport.open_client(endpoint, timeout=30.0) as session:
        mute = AliveToken(session, alive_key("mute"))

        def names() -> list[str]:
            return [state.robot for state in robot_states(session)]

        assert eventually(lambda: names() == ["ada", "bob", "mute", "rex"])
        assert eventually(lambda: robot_states(session)[0].step == 4)
        ada, bob, silent, rex = robot_states(session)
        assert ada.health is Health.OK and 0 <= ada.age < 60 and ada.links == 1 and ada.message == "" and ada.run
        assert bob.step is None and math.isnan(bob.age) and rex.links == 1
        assert silent.health is Health.STALE and "did not reply" in silent.message
        assert [state.robot for state in robot_states(session, robots=["rex", "nobody"])] == ["rex"]
        gone.kill()
        assert eventually(lambda: names() == ["ada", "mute", "rex"])
        mute.close()
        with pytest.raises(transport.ScannerUnavailable, match="none of nobody was found"):
            robot_states(session, robots=["nobody"])


def test_a_robot_speaks_for_no_other(endpoint: str) -> None:
    """An answer on the key of one robot that names another one is ignored; invalid values count as not given."""

    def answer(robot: str, claimed: str, step: str) -> Callable[[Any], None]:
        item = StatusItem(name=STATUS_NAME, level=Health.OK, hardware_id=claimed, values={"step": step, "links": step})
        payload = encode_status(Status(stamp=1, items=(item,)))

        def on_query(query: Any) -> None:
            query.reply(status_key(robot), payload)
            query.drop()

        return on_query

    with (
        transport.open_node(listen=endpoint) as node,
        transport.open_client(endpoint, timeout=30.0) as session,
    ):
        kept = [AliveToken(node, alive_key(robot)) for robot in ("ada", "bob", "rex")]
        asked = {"ada": ("ada", "--3"), "bob": ("bob", "²"), "rex": ("ada", "9")}
        raw = [
            zenoh_api.declare_queryable(node.raw, status_key(robot), answer(robot, *values))
            for robot, values in asked.items()
        ]
        ada, bob, rex = robot_states(session, timeout=20.0)
        assert (ada.robot, bob.robot, rex.robot) == ("ada", "bob", "rex") and len(raw) == len(kept)
        assert ada.health is bob.health is Health.OK and ada.step is bob.step is None and ada.links == bob.links == 0
        assert rex.health is Health.STALE and "did not reply" in rex.message
