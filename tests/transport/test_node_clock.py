"""The node's clock as its status tells it: only a finite one counts."""

import pytest

from transport import Health, Status, StatusItem, encode_status, open_node
from transport.grids.node_clock import NodeClock
from transport.messages.status_message import STATUS_NAME


@pytest.mark.parametrize("reading", ["nan", "inf", "-inf", "1e400", "", "9" * 5000])
def test_a_clock_that_is_no_number_tells_no_age(free_endpoint: str, reading: str) -> None:
    """Against NaN every age would be 0, and the grid fresh for ever."""
    values = {"run": "a", "clock_s": reading}
    items = (StatusItem(name=STATUS_NAME, level=Health.OK, values=values),)
    with open_node(listen=free_endpoint) as session:
        node_clock = NodeClock(session, "guara", lambda status, asked: "")
        node_clock._take(bytes(encode_status(Status(stamp=1, items=items))), 1.0, 2.0)
        assert node_clock.age("a", 5.0) is None
