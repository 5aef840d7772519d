"""Tests of scan requests: one scan per request, exactly one end, every failure under its own name."""

import signal
import threading
import time

import pytest

import transport
from transport import keys, zenoh_api
from transport.messages.scan_messages import decode_refusal, encode_scan_request


def _client(endpoint: str) -> transport.PerceptionClient:
    return transport.PerceptionClient(transport.open_client(endpoint, timeout=180.0))


def test_a_request_ends_with_its_grid(shared_node) -> None:
    """A planner follows a scan and gets the grid that it made, also the second time."""
    _, endpoint = shared_node
    with _client(endpoint) as client:
        progress: list[int] = []
        first = client.request_scan(
            mode="coarse", timeout=30.0, on_progress=lambda reply: progress.append(reply.stripes_done)
        )
        assert progress == sorted(progress) and set(progress) <= {1, 2, 3}
        assert client.request_scan(timeout=180.0).sequence == first.sequence + 1


def test_the_same_id_is_one_scan(shared_node) -> None:
    """A repeated request returns the same scan, while it runs and after it is done."""
    node, endpoint = shared_node
    with _client(endpoint) as one, _client(endpoint) as two:
        found: list[int] = []
        both = [
            threading.Thread(target=lambda c=c: found.append(c.request_scan(timeout=30.0, request_id="same").sequence))
            for c in (one, two)
        ]
        for thread in both:
            thread.start()
        for thread in both:
            thread.join()
        found.append(one.request_scan(timeout=30.0, request_id="same").sequence)
    assert len(found) == 3 and len(set(found)) == 1
    assert node.lines.count("scanning same") == 1


@pytest.mark.parametrize(
    ("behaviour", "error", "expected_text"),
    [
        ("fail", transport.ScanFailed, r"no_camera\): the camera is gone"),
        ("crash", transport.ScanFailed, r"internal\): a mistake"),
        ("walking", transport.ScanFailed, r"not_stationary\): the robot walks"),
        ("slow", transport.ScanTimeout, r"within 0.6 s: the deadline of 0.6 s passed"),
    ],
)
def test_each_failure_has_its_name(shared_node, behaviour: str, error: type, expected_text: str) -> None:
    """What went wrong at the scanner reaches the planner as the error that it is."""
    _, endpoint = shared_node
    with _client(endpoint) as client, pytest.raises(error, match=expected_text):
        timeout = 0.6 if behaviour == "slow" else 30.0
        client.request_scan(timeout=timeout, request_id=f"{behaviour}-failure")


def test_a_second_request_meanwhile_is_busy(start, endpoint: str) -> None:
    """Only one scan runs; the other asker is refused at once."""
    node = start("node", endpoint)
    with _client(endpoint) as one, _client(endpoint) as two:
        waiting = threading.Thread(target=_ignore_errors, args=(one,))
        waiting.start()
        node.expect("scanning")
        with pytest.raises(transport.ScanBusy, match="another request"):
            two.request_scan(timeout=180.0)
        node.kill()
        waiting.join(30.0)
        assert not waiting.is_alive()


def _ignore_errors(client: transport.PerceptionClient) -> None:
    try:
        client.request_scan(timeout=60.0, request_id="slow-busy")
    except transport.TransportError:
        return


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_scanner_that_dies_or_hangs_is_gone(start, endpoint: str, number: signal.Signals) -> None:
    """Killed or hung in the middle of a scan, the asker hears long before its deadline."""
    start("router", endpoint)
    node = start("node", endpoint, "connect")
    errors: list[BaseException] = []
    with _client(endpoint) as client:
        assert client.wait_until_alive(30.0)

        def ask() -> None:
            try:
                client.request_scan(timeout=300.0, request_id="slow-death")
            except BaseException as error:
                errors.append(error)

        asker = threading.Thread(target=ask)
        asker.start()
        node.expect("scanning")
        node.send(number)
        asker.join(60.0)
        assert not asker.is_alive()
    assert isinstance(errors[0], transport.ScannerGone), errors


@pytest.mark.slow
def test_after_a_timeout_the_scanner_takes_the_next_request(endpoint: str, peer) -> None:
    """The handler learns that the deadline passed, and the scanner is free when it returns."""
    reported = threading.Event()

    def scan(job: transport.ScanJob) -> transport.TerrainMessage:
        if job.request.id == "first":
            assert job.cancelled.wait(30.0) and job.remaining == 0.0
            reported.set()
        server.publish(terrain := peer.make_terrain(server.next_sequence("footprint")))
        return terrain

    with transport.open_node(listen=endpoint) as session:
        server = transport.PerceptionServer(session)
        server.serve_scans(scan)
        with _client(endpoint) as client:
            with pytest.raises(transport.ScanTimeout):
                client.request_scan(timeout=0.3, request_id="first")
            assert reported.wait(30.0)
            deadline = time.monotonic() + 30.0
            while True:
                try:
                    assert client.request_scan(timeout=180.0).sequence == 2
                    break
                except transport.ScanBusy:
                    assert time.monotonic() < deadline


def test_an_invalid_request_is_refused(shared_node) -> None:
    """Bytes that are no request get a refusal with a message, and the scanner goes on."""
    _, endpoint = shared_node
    with transport.open_client(endpoint, timeout=180.0) as session:
        for payload in (b"", b"nonsense", encode_scan_request(
            transport.ScanRequest(id="a", mode="coarse", timeout=1.0))[:-4]):  # fmt: skip
            errors: list[bytes | None] = []
            ended = threading.Event()
            zenoh_api.get_replies(
                session.raw,
                keys.scan_key(),
                30.0,
                lambda reply, found=errors: found.append(reply.error),
                ended.set,
                payload=payload,
            )
            assert ended.wait(30.0)
            assert decode_refusal(errors[0]).code == "bad_request"
        assert transport.PerceptionClient(session).request_scan(timeout=180.0).sequence > 0


@pytest.mark.parametrize(
    ("fields", "expected_text"),
    [
        ({"mode": "fast"}, "mode is 'fast'"),
        ({"timeout": 0.0}, "timeout is 0.0 s; allowed: more than 0"),
        ({"timeout": float("nan")}, "timeout is nan"),
        ({"id": ""}, "0 characters"),
        ({"id": "x" * 201}, "201 characters; allowed: 1 to 200"),
    ],
)
def test_a_wrong_request_is_refused_before_it_is_sent(fields: dict, expected_text: str) -> None:
    """The asker's own mistakes are named."""
    with pytest.raises(transport.MessageError, match=expected_text):
        transport.ScanRequest(**({"id": "a", "mode": "coarse", "timeout": 1.0} | fields))


@pytest.mark.slow
def test_grids_of_an_earlier_node_do_not_answer_a_request(endpoint: str, peer) -> None:
    """After a restart the numbers start again; the grid returned is the one that was asked for."""
    router = transport.open_node(listen=endpoint)
    with _client(endpoint) as client:
        for stamp in (peer.STAMP, peer.STAMP + 10**12):
            with transport.open_node(connect=endpoint) as session:
                server = transport.PerceptionServer(session)

                def scan(_: object, server=server, stamp=stamp) -> transport.TerrainMessage:
                    terrain = peer.make_terrain(server.next_sequence("footprint"), stamp=stamp)
                    server.publish(terrain)
                    return terrain

                server.serve_scans(scan)
                assert client.wait_until_alive(30.0)
                terrain = client.request_scan(timeout=180.0)
                assert (terrain.sequence, terrain.stamp) == (1, stamp)
    router.close()


@pytest.mark.slow
def test_a_node_that_lives_before_it_scans_is_asked_again(endpoint: str, peer) -> None:
    """A node that comes up: its life is known a little before its service, and the request finds it all the same."""
    with transport.open_node(listen=endpoint) as session, _client(endpoint) as client:
        server = transport.PerceptionServer(session)
        assert client.wait_until_alive(30.0)

        def scan(_: object) -> transport.TerrainMessage:
            terrain = peer.make_terrain(server.next_sequence("footprint"), stamp=peer.STAMP)
            server.publish(terrain)
            return terrain

        late = threading.Timer(0.2, server.serve_scans, [scan])
        late.start()
        assert client.request_scan(timeout=180.0).stamp == peer.STAMP
        late.join()


@pytest.mark.slow
def test_a_scanner_that_died_before_it_answered_is_gone(endpoint: str) -> None:
    """It was alive when it was asked and is not any more: gone, not unavailable; without a life sign: unavailable."""
    from transport.queries.scan_client import request_scan

    with transport.open_node(listen=endpoint), transport.open_client(endpoint) as session:
        lives = iter([True])
        with pytest.raises(transport.ScannerGone, match="before it replied"):
            request_scan(session, timeout=5.0, is_alive=lambda: next(lives, False))
        with pytest.raises(transport.ScannerUnavailable):
            request_scan(session, timeout=5.0, is_alive=lambda: False)
        with pytest.raises(transport.ScannerUnavailable):
            request_scan(session, timeout=5.0, is_alive=lambda: True)
