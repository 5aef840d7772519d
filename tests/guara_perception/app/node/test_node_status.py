"""Status items of drift checks and of the pause."""

from __future__ import annotations

import time

import pytest

from guara_perception.app.node.node_status import NodeStatus
from guara_perception.calibration.drift import DRIFTING, HOLDS, UNKNOWN, Drift
from tests.guara_perception.app.node.live_bench import TIMEOUT, Bench
from transport import Health, PausePhase, StatusItem
from transport.server import PerceptionServer


def checked(verdict: str) -> Drift:
    """Drift check with a given verdict."""
    reasons = ("the floor is at +9.0 mm relative to the soles",) if verdict == DRIFTING else ()
    return Drift(verdict, reasons, 0.8, 0.009, 0.001, 1e-5, 12, 1e-5)


def test_drift_warns_when_pauses_agree_and_counts_those_without_a_floor() -> None:
    """One drifting scan is reported without a warning, two give a warning; scans without a floor are counted."""
    status = NodeStatus()
    said = []
    for verdict in (UNKNOWN, HOLDS, DRIFTING, UNKNOWN, DRIFTING):
        status.drift(checked(verdict))
        (item,) = [item for item in status.items() if item.name == "drift"]
        said.append((item.level, item.values["verdict"]))
    assert [level for level, _ in said] == [Health.OK] * 4 + [Health.WARN]
    assert [verdict for _, verdict in said] == [UNKNOWN, HOLDS, HOLDS, HOLDS, DRIFTING]
    assert item.message.startswith("calibration: drifting, floor found in 3 of 5 scans; last scan: the floor is at +9")
    assert (item.values["scans_unknown"], item.values["scans_drifting"], item.values["scans_holds"]) == ("2", "2", "1")


def test_what_changes_is_sent_at_once(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A problem, a confirmation and a scan are sent at once, not only with the periodic status."""
    sent: list[PerceptionServer] = []
    monkeypatch.setattr(PerceptionServer, "status_changed", lambda server: sent.append(server))
    bench.status.problem("scan", "the mirror jammed")
    assert len(sent) == 1
    bench.status.confirmed(3)
    assert len(sent) == 2


def test_a_client_is_told_where_the_robot_is_in_its_walk(bench: Bench) -> None:
    """Before the first pause, standing after the scan, and walking: when the next grid can be expected."""

    def reached(state: str) -> StatusItem:
        end = time.monotonic() + TIMEOUT
        while time.monotonic() < end:
            status = bench.client.status()
            for item in status.items if status else ():
                if item.name == "pause" and item.values["state"] == state:
                    assert item.level == Health.OK
                    return item
            time.sleep(0.05)
        raise AssertionError(f"no status says {state!r}")

    assert reached("none").message.startswith("no stance pause has been announced yet")
    bench.gait.say(7, PausePhase.BEGIN)
    standing = reached("standing")
    assert standing.values["step"] == "7" and "its scan is done: the next grid comes" in standing.message
    bench.gait.say(7, PausePhase.END)
    moving = reached("moving")
    assert moving.values["step"] == "7"
    # Both clocks are those of this machine.
    assert abs(float(moving.values["clock_ahead_s"])) <= float(moving.values["clock_bound_s"]) + 0.01
    (scanner,) = (item for item in bench.status.items() if item.name == "scanner")
    assert sum(float(value) for name, value in scanner.values.items() if name.startswith("seconds_")) > 0.0
