"""How long an announced message is waited for: learnt from those that came by themselves."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

import transport
from transport.keys import terrain_key
from transport.links.fetcher import LONGEST_GRACE, MARGIN, SHORTEST_GRACE, Patience
from transport.links.publisher import Publisher


def test_before_anything_is_known_it_is_the_longest() -> None:
    """Then it is MARGIN times the largest lateness, within the bounds; a single late message is forgotten slowly."""
    patience = Patience()
    assert patience.grace == LONGEST_GRACE
    patience.learn(-0.01)
    assert patience.grace == SHORTEST_GRACE
    patience.learn(0.01)
    assert patience.grace == pytest.approx(MARGIN * 0.01)
    patience.learn(0.0)
    assert SHORTEST_GRACE < patience.grace < MARGIN * 0.01
    patience.learn(10.0)
    assert patience.grace == LONGEST_GRACE
    for _ in range(100):
        patience.learn(0.001)
    assert patience.grace == SHORTEST_GRACE


@given(st.lists(st.floats(-1, 10), min_size=1, max_size=50))
def test_what_came_is_never_given_up_the_next_time(lateness: list[float]) -> None:
    """A message as late as the one before is still waited for, and none longer than the longest."""
    patience = Patience()
    for late in lateness:
        patience.learn(late)
        assert SHORTEST_GRACE <= patience.grace <= LONGEST_GRACE
        assert patience.grace >= min(late, LONGEST_GRACE)


@pytest.mark.slow
def test_what_is_lost_on_the_way_is_fetched(endpoint: str, eventually) -> None:
    """Samples that never come by themselves: each is fetched once it is missed, and counted."""
    with transport.open_node(listen=endpoint) as node, transport.open_client(endpoint, timeout=30.0) as session:
        publisher = Publisher(node, terrain_key())
        receiver = transport.NewestReceiver(session, terrain_key(), bytes)
        for number in range(5):
            publisher.put(b"%d" % number)
            assert receiver.wait_for(lambda got, number=number: got == b"%d" % number, 30.0)
        before = receiver.fetched
        # As when the link takes nothing large: the subscription is gone, the announcements come.
        receiver._raw.undeclare()
        for number in range(5, 8):
            publisher.put(b"%d" % number)
            assert receiver.wait_for(lambda got, number=number: got == b"%d" % number, 30.0)
        assert receiver.fetched == before + 3 and receiver.received == 8 and receiver.missed == 0
