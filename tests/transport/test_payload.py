"""Payloads that are made when somebody wants them: by whom, and once."""

import threading

import pytest

import transport
from transport.keys import terrain_key
from transport.links.last_message import MadeOnce
from transport.links.publisher import Publisher


def test_it_is_made_once_however_many_ask() -> None:
    """Also when they ask at the same instant."""
    made: list[int] = []
    payload = MadeOnce(lambda: (made.append(1), b"grid")[1])
    assert made == []
    found: list[bytes] = []
    threads = [threading.Thread(target=lambda: found.append(bytes(payload()))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30.0)
    assert found == [b"grid"] * 8 and made == [1]


@pytest.mark.slow
def test_who_comes_later_has_it_made_and_who_is_there_gets_it_sent(endpoint: str, eventually) -> None:
    """Nobody: nothing is made. A late joiner: the last is made for it. Then each as it is published."""
    made: list[int] = []

    def make(number: int) -> bytes:
        made.append(number)
        return b"%d" % number

    with transport.open_node(listen=endpoint) as node:
        publisher = Publisher(node, terrain_key(), answers=True)
        for number in (1, 2, 3):
            publisher.put(lambda number=number: make(number))
        assert made == []
        with transport.open_client(endpoint, timeout=30.0) as session:
            receiver = transport.NewestReceiver(session, terrain_key(), bytes)
            assert receiver.wait_for(lambda got: got == b"3", 30.0) and made == [3]
            for number in (4, 5):
                publisher.put(lambda number=number: make(number))
                assert receiver.wait_for(lambda got, number=number: got == b"%d" % number, 30.0)
            assert made == [3, 4, 5] and receiver.missed == 0
