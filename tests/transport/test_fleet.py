"""The robots that live on a router, by sign of life and status: real nodes in other processes."""

import math

import pytest

import transport
from tests.ports import free_endpoint
from transport import Health
from transport.fleet import robot_states
from transport.keys import alive_key
from transport.liveliness import AliveToken


@pytest.mark.slow
def test_all_that_live_are_told_with_step_age_health_and_links(start, endpoint: str, eventually) -> None:
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
        assert silent.health is Health.STALE and "did not answer" in silent.message
        assert [state.robot for state in robot_states(session, robots=["rex", "nobody"])] == ["rex"]
        gone.kill()
        assert eventually(lambda: names() == ["ada", "mute", "rex"])
        mute.close()
        with pytest.raises(transport.ScannerUnavailable, match="none of nobody is to be seen"):
            robot_states(session, robots=["nobody"])
