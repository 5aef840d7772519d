"""Stance pauses between processes: both ends are heard, an invalid announcement is reported."""

import struct
from typing import Any

import numpy as np
import pytest

import transport
from transport import clock, keys, zenoh_api
from transport.links.publisher import Publisher
from transport.messages.codec import encode
from transport.messages.stance_pause import make_stance_pause
from transport.stance_link import GaitClock


def test_both_ends_of_a_pause_reach_the_node(start, endpoint: str, peer) -> None:
    """Begin and end are seen in order, and a node that comes later still gets the last one."""
    node = start("node", endpoint)
    with transport.open_client(endpoint, timeout=180.0) as session:
        publisher = transport.StancePublisher(session)
        for phase in (transport.PausePhase.BEGIN, transport.PausePhase.END):
            publisher.publish(
                transport.StancePause(robot="guara", step=4, phase=phase, stamp=1, stance=peer.make_stance())
            )
            assert node.expect("pause") == f"pause 4 {phase.name}"
        with pytest.raises(transport.MessageError, match=r"of robot 'lobo' cannot be published on the key of 'guara'"):
            publisher.publish(transport.StancePause(robot="lobo", step=5, phase=1, stamp=1, stance=peer.make_stance()))
        publisher.publish(transport.StancePause(robot="guara", step=5, phase=1, stamp=1, stance=peer.make_stance()))
        publisher.flush(30.0)
        late: list[int] = []
        receiver = transport.StanceReceiver(session, on_pause=lambda pause: late.append(pause.step))
        assert receiver.wait_for(lambda pause: pause.step == 5, 30.0)


@pytest.mark.slow
def test_an_invalid_announcement_is_reported_and_the_next_one_heard(endpoint: str, eventually) -> None:
    """Damaged bytes, or a joint that is NaN, must not pass unnoticed: it may have been the end of a pause."""
    refused: list[str] = []
    heard: list[int] = []
    with transport.open_node(listen=endpoint) as session, transport.open_client(endpoint, timeout=180.0) as other:
        transport.StanceReceiver(
            session,
            on_pause=lambda pause: heard.append(pause.step),
            on_refused=lambda error: refused.append(str(error)),
        )
        raw = Publisher(other, keys.stance_key("guara"))
        raw.put(b"no message at all")
        assert eventually(lambda: len(refused) == 1)
        stance = transport.StanceMessage(joint_positions={"lf_haa_joint": 0.1}, support_feet=("lf",))
        good = transport.StancePause(robot="guara", step=7, phase=transport.PausePhase.END, stamp=1, stance=stance)
        broken = make_stance_pause(good)
        broken.stance.joint_positions[0] = np.nan
        raw.put(encode(broken))
        assert eventually(lambda: len(refused) == 2) and "lf_haa_joint" in refused[1] and heard == []
        raw.put(encode(make_stance_pause(good)))
        assert eventually(lambda: heard == [7])


@pytest.mark.slow
def test_a_second_publisher_of_a_session_takes_the_place_of_the_first(endpoint: str, peer, eventually) -> None:
    """A node that comes within the new walk's pause hears its BEGIN, and not the END of the walk before."""
    with transport.open_node(listen=endpoint) as session, transport.open_client(endpoint, timeout=180.0) as other:

        def say(publisher: transport.StancePublisher, step: int, phase: transport.PausePhase) -> None:
            reported = {"robot": "guara", "step": step, "phase": phase, "stamp": 1, "stance": peer.make_stance()}
            publisher.publish(transport.StancePause(**reported))
            publisher.flush(30.0)

        first, second = transport.StancePublisher(other), transport.StancePublisher(other)
        say(first, 7, transport.PausePhase.END)
        for publisher, step in ((second, 0), (first, 8)):
            say(publisher, step, transport.PausePhase.BEGIN)
            heard: list[tuple[str, int]] = []
            receiver = transport.StanceReceiver(
                session, on_pause=lambda p, heard=heard: heard.append((p.phase.name, p.step))
            )
            assert eventually(lambda heard=heard, step=step: ("BEGIN", step) in heard)
            say(publisher, step, transport.PausePhase.HOLD)
            assert eventually(lambda heard=heard, step=step: ("HOLD", step) in heard)
            assert heard == [("BEGIN", step), ("HOLD", step)]
            receiver.close()


@pytest.mark.slow
def test_who_comes_within_a_pause_hears_its_begin_and_not_its_holds(endpoint: str, peer, eventually) -> None:
    """HOLD is for those who listen now; a node that starts meanwhile needs the BEGIN, and then hears every HOLD."""
    with transport.open_node(listen=endpoint) as session, transport.open_client(endpoint, timeout=180.0) as other:
        publisher = transport.StancePublisher(other)

        def say(phase: transport.PausePhase, stamp: int) -> None:
            reported = {"robot": "guara", "step": 5, "phase": phase, "stamp": stamp, "stance": peer.make_stance()}
            publisher.publish(transport.StancePause(**reported))
            publisher.flush(30.0)

        say(transport.PausePhase.BEGIN, 1)
        say(transport.PausePhase.HOLD, 2)
        heard: list[tuple[str, int]] = []
        transport.StanceReceiver(session, on_pause=lambda pause: heard.append((pause.phase.name, pause.stamp)))
        assert eventually(lambda: heard == [("BEGIN", 1)])
        for stamp in range(3, 40):
            say(transport.PausePhase.HOLD, stamp)
        say(transport.PausePhase.END, 40)
        assert eventually(lambda: heard[-1] == ("END", 40))
        assert heard == [("BEGIN", 1), *(("HOLD", stamp) for stamp in range(3, 40)), ("END", 40)]


@pytest.mark.slow
def test_the_gaits_clock_is_found_by_a_round_trip_and_again_when_it_is_set(endpoint: str, eventually) -> None:
    """Whatever it shows: a stamp is taken for as early as it can have been read, never for later than it was."""
    shown = [700_000_000]
    news: list[float | None] = []
    with transport.open_node(listen=endpoint) as session, transport.open_client(endpoint, timeout=180.0) as other:
        gait_clock = GaitClock(session, on_news=lambda: news.append(1))
        assert gait_clock.earliest(0) is None
        publisher = transport.StancePublisher(other, clock=lambda: round(clock.now() * 1e9) + shown[0])
        assert eventually(lambda: news != [])
        for offset in (700_000_000, -300_000_000):
            shown[0] = offset

            def is_found(offset: int = offset) -> bool:
                now = clock.now()
                earliest = gait_clock.earliest(round(now * 1e9) + offset)
                assert earliest is not None
                return abs(earliest - now) < 0.1

            assert eventually(is_found)
            now = clock.now()
            earliest = gait_clock.earliest(round(now * 1e9) + offset)
            assert earliest is not None and earliest <= now + 1e-6
        publisher.close()
        assert gait_clock.earliest(0) is not None and not gait_clock.ask(timeout=0.5)


@pytest.mark.slow
def test_an_answer_that_is_no_time_is_refused(endpoint: str, eventually) -> None:
    """The clock stays unknown, and the node goes on asking; the bytes of docs/other-languages.md are one."""
    asked: list[int] = []
    payload = [b"noon"]

    def answer(query: Any) -> None:
        asked.append(1)
        query.reply(keys.gait_clock_key("guara"), payload[0])
        query.drop()

    with transport.open_node(listen=endpoint) as session:
        declared = zenoh_api.declare_queryable(session.raw, keys.gait_clock_key("guara"), answer)
        gait_clock = GaitClock(session)
        assert eventually(lambda: len(asked) > 1)
        assert gait_clock.earliest(0) is None
        payload[0] = b"\x00\x01\x00\x00" + struct.pack("<iI", 7, 500_000_000)
        assert eventually(lambda: gait_clock.earliest(0) is not None)
        earliest = gait_clock.earliest(7_500_000_000)
        assert earliest is not None and 0.0 <= clock.now() - earliest < 180.0
        declared.undeclare()
