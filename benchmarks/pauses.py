"""Scans confirmed within the time that a gait announces, on a loaded machine.

Usage: python -m benchmarks pauses [--pauses 20] [--quick]

Node (emulated board and camera in real time, adaptive), gait and planner are a process each; two more keep the machine
busy. The joints have the noise of robot.toml in every message. `example` is examples/gait_side.py; the other gaits
send HOLD at 50 Hz or never, and END later than announced by the time in the table.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import guara_perception as gp
from benchmarks.command import Table, options
from benchmarks.node import listening, showing
from benchmarks.peers import free_endpoint, peers, report, standing
from guara_perception.app.node.simulated import SimulatedGait
from kinematics import load_robot
from testbed.emulated_sweeps import view_of
from testbed.scenes import scan_stance, simulated
from transport import StancePublisher, open_client

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "gait_side.py"
TIMEOUT = 60.0
HOLD_PERIOD = 0.02
# Announced time [s], kind of gait, and delay of END relative to the announced time [s].
CASES = (
    (4.0, "example", 0.0),
    (3.0, "example", 0.0),
    *((announced, "no HOLD", late) for late in (0.0, 0.02, 0.4) for announced in (4.0, 3.0)),
    (4.0, "HOLD", 0.02),
    (4.0, "HOLD", 0.4),
    (3.0, "HOLD", 0.4),
)
QUICK = (CASES[0], CASES[5], CASES[6])
# Between two pauses the robot swings a leg [s]; the Guará takes 2.6 s and more.
SWING = 2.0


def run_node(endpoint: str) -> None:
    """Node over emulated devices that keep real time; each picture is rendered once."""
    scan = simulated((640, 512), 70, is_uncertain=False)
    rangefinder = showing(view_of(scan), exposure=0.004, latency=0.002)
    with listening(scan.robot, scan.calibration, rangefinder, "adaptive", endpoint):
        report(ready=True)
        sys.stdin.read()


def run_planner(endpoint: str) -> None:
    """Planner that reports every grid as it arrives."""
    with gp.TerrainClient(endpoint, timeout=TIMEOUT) as client:

        def take(grid: gp.TerrainGrid) -> None:
            report(
                step=grid.step,
                epoch=grid.metadata["epoch"],
                stripes=grid.metadata["stripes_used"],
                confirmed=not grid.is_provisional,
                withdrawn=bool(grid.metadata.get("withdrawn")),
                follows=bool(grid.metadata.get("refinement_follows")),
            )

        report(ready=True)
        client.on_terrain(take)
        sys.stdin.read()


def run_gait(endpoint: str, pauses: str, announced: str, late: str, kind: str) -> None:
    """Gait that sends END `late` [s] after the time that it announced, and HOLD if that is its kind."""
    robot, seconds = load_robot("guara"), float(announced)
    stood = standing(robot, scan_stance(robot))
    with open_client(endpoint, timeout=TIMEOUT) as session:
        publisher = StancePublisher(session)
        gait = SimulatedGait(publisher, "guara", seconds, seed=os.getpid())
        report(ready=True)
        for step in range(int(pauses)):
            pause, end = replace(stood, step=step), time.monotonic() + seconds + float(late)
            gait.begin(pause)
            while (left := end - time.monotonic()) > 0:
                time.sleep(min(HOLD_PERIOD, left) if kind == "HOLD" else left)
                if kind == "HOLD":
                    gait.hold(pause)
            gait.end(pause)
            time.sleep(SWING)
        publisher.flush(TIMEOUT)
        # The process must outlast the confirmation of its last END.
        time.sleep(1.0)


def measure(pauses: int, cases: tuple[tuple[float, str, float], ...]) -> None:
    """Print the pauses of each case, with one node, one planner and two busy processes beside them."""
    head = "announced s:g | gait:<8 | END late ms:.0f | pauses:d | confirmed:d | arrived:d | coarse first:d"
    table = Table(f"{head} | withdrawn:d | stripes:g")
    heard: list[dict[str, Any]] = []
    endpoint = free_endpoint()
    with ExitStack() as stack:
        for _ in range(2):
            busy = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.callback(busy.wait)
            stack.callback(busy.kill)
        start = stack.enter_context(peers())
        start("node", endpoint, module="pauses")
        planner = start("planner", endpoint, module="pauses")
        planner.follow(heard.append)
        for announced, gait, late in cases:
            known = {grid["epoch"] for grid in heard}
            limit = pauses * (announced + late + SWING) + TIMEOUT
            if gait == "example":
                command = [str(EXAMPLE), endpoint, "--pauses", str(pauses), "--seconds", str(announced)]
                subprocess.run([sys.executable, *command], timeout=limit, check=True, stdout=subprocess.DEVNULL)
                time.sleep(1.0)
            else:
                start("gait", endpoint, str(pauses), str(announced), str(late), gait, module="pauses").popen.wait(limit)
            found = _figures([grid for grid in heard if grid["epoch"] not in known])
            table.row(announced, gait, 1e3 * late, pauses, *found)


def _figures(grids: list[dict[str, Any]]) -> tuple[float, ...]:
    """Numbers of pauses of one case, and the median number of stripes of the confirmed grids.

    A pause has arrived if a grid came before END, or confirmed after it; coarse first if a coarse grid came before its
    refinement.
    """
    good = [grid for grid in grids if not grid["withdrawn"]]
    confirmed = [grid for grid in good if grid["confirmed"]]
    coarse_first = [grid for grid in good if grid["follows"]]
    withdrawn = [grid for grid in grids if grid["withdrawn"]]
    counts = (len({grid["step"] for grid in each}) for each in (confirmed, good, coarse_first, withdrawn))
    return *counts, statistics.median([grid["stripes"] for grid in confirmed] or [0])


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        pauses=(20, "pauses of each case; at most 100"),
        quick=(False, "three of the cases"),
    )
    measure(min(asked.pauses, 100), QUICK if asked.quick else CASES)


if __name__ == "__main__":
    main()
