"""Processor time and log lines that messages cost a node: HOLD at 100 Hz and more, floods of unusable messages.

Usage: python -m benchmarks transport announcements [--seconds 5]

The node runs in this process, so that its processor time can be read; the gait sends from a process of its own. In each
round, silence of the same length precedes every kind of message.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import queue
import statistics
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from logging.handlers import QueueHandler

import numpy as np

from benchmarks.command import options
from benchmarks.node import listening
from benchmarks.peers import Peer, free_endpoint, peers, report
from guara_perception.app.messages import stance_to_message
from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.simulated import SimulatedRobot
from guara_perception.simulation.walk import fresh_reading
from transport import PausePhase, StancePause, encode_stance_pause, open_client
from transport.keys import stance_key
from transport.links.publisher import Publisher
from transport.stance_link import StancePublisher

# Kind of message, and how many are sent per second. Floods come last: a message that cannot be read ends the pause.
HOLDS = (("hold", 100.0), ("hold", 500.0))
FLOODS = (("malformed", 1000.0), ("of another robot", 1000.0))
ROUNDS = 3
TIMEOUT = 60.0
# Lines that the log may get per second, whatever is sent.
ALLOWED_LINES = 1.0


def _payload(kind: str, hold: StancePause) -> bytes | bytearray:
    if kind == "malformed":
        return b"no message at all"
    return encode_stance_pause(hold if kind == "hold" else dataclasses.replace(hold, robot="other"))


def run_gait(endpoint: str) -> None:
    """Announce BEGIN of step 0, then send messages of the kind, rate and duration that each input line requests."""
    stance, rng = next(SimulatedRobot().walk(cycles=0)).stance, np.random.default_rng(0)
    begin = StancePause(
        robot="guara",
        step=0,
        phase=PausePhase.BEGIN,
        stamp=time.time_ns(),
        stance=stance_to_message(fresh_reading(stance, rng)),
    )
    with open_client(endpoint, timeout=TIMEOUT) as session:
        # It announces the clock of the stamps; it would not send all the messages below.
        StancePublisher(session)
        latched = Publisher(session, stance_key("guara"))
        plain = Publisher(session, stance_key("guara"), latched=False)
        latched.put(encode_stance_pause(begin))
        report(ready=True)
        for line in sys.stdin:
            command = json.loads(line)
            start, count = time.monotonic(), 0
            while (elapsed := time.monotonic() - start) < command["seconds"]:
                if elapsed < count / command["rate"]:
                    time.sleep(count / command["rate"] - elapsed)
                    continue
                read = stance_to_message(fresh_reading(stance, rng))
                hold = dataclasses.replace(begin, phase=PausePhase.HOLD, stamp=time.time_ns(), stance=read)
                plain.put(_payload(command["kind"], hold))
                count += 1
            report(sent=count)


@contextmanager
def standing_node() -> Iterator[tuple[Peer, NodeStatus]]:
    """Start a node and a gait process, and scan once; yield the gait and the status of the node."""
    simulated, endpoint = SimulatedRobot(), free_endpoint()
    with (
        listening(simulated.robot, simulated.calibration, simulated.rangefinder, "coarse", endpoint) as (node, status),
        peers() as start,
    ):
        gait = start("gait", endpoint, module="announcements")
        if not node.wait_for_step(0, TIMEOUT):
            raise SystemExit(f"step 0 gave no grid within {TIMEOUT:.0f} s")
        yield gait, status


def measure(seconds: float) -> dict[str, tuple[int, float, float]]:
    """Cost of a kind of message for the node, by kind and rate, such as "hold at 100 Hz".

    Number of messages sent in all rounds, processor time of one beyond that of silence (median of the rounds) [ms], and
    lines of the log in a second (largest of the rounds).

    Args:
        seconds: how long each kind is sent in each round.

    Raises:
        SystemExit: the first pause gave no grid, or HOLD did not confirm it.
    """
    log, root = queue.SimpleQueue[logging.LogRecord](), logging.getLogger()
    handler, threshold = QueueHandler(log), root.level
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    rounds: dict[str, list[tuple[int, float, float]]] = {}
    try:
        with standing_node() as (gait, status):
            for kinds in (HOLDS, FLOODS):
                for _ in range(ROUNDS):
                    for kind, rate in kinds:
                        name = f"{kind} at {rate:g} Hz"
                        begun = time.process_time()
                        time.sleep(seconds)
                        silence, lines = time.process_time() - begun, log.qsize()
                        gait.send(kind=kind, rate=rate, seconds=seconds)
                        count = gait.receive()["sent"]
                        spent = 1e3 * (time.process_time() - begun - 2 * silence) / count
                        rounds.setdefault(name, []).append((count, spent, (log.qsize() - lines) / seconds))
                (scanner,) = [item for item in status.items() if item.name == "scanner"]
                if scanner.values["provisional"] != "false":
                    raise SystemExit("HOLD did not confirm the grid: the scanner's status still says provisional")
    finally:
        root.removeHandler(handler)
        root.setLevel(threshold)
    columns = {name: tuple(zip(*each, strict=True)) for name, each in rounds.items()}
    return {name: (sum(sent), statistics.median(spent), max(lines)) for name, (sent, spent, lines) in columns.items()}


def main() -> None:
    """Processor time and log lines that HOLD and floods cost a node [--seconds S]."""
    asked = options(__doc__, seconds=(5.0, "how long each kind is sent in each round; at most 60"))
    costs = measure(min(max(asked.seconds, 0.1), 60.0))
    for name, (sent, spent_ms, lines) in costs.items():
        print(f"{name:<28} {sent:>6} sent, {spent_ms:6.3f} ms of processor time each, {lines:.1f} log lines per second")
    sys.exit(any(lines > ALLOWED_LINES for _, _, lines in costs.values()))
