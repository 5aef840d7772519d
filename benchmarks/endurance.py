"""Hours with faults at random: a walking node that records, two planners and a viewer, and whether anything grows.

`python -m benchmarks endurance [--minutes 240] [--period 20]`. Each is a process of its own over real Zenoh; the robot
is simulated. Node and second planner are killed or stopped for some seconds; router, first planner and viewer live on.
In the second half the node is only stopped, so that its own growth shows.
A contradiction is a footprint handed out for a pause after which its planner has heard of another one for 3 s.
"""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import guara_perception as gp
from benchmarks.command import options
from benchmarks.peers import PATIENCE, ROOT, ended, free_endpoint, free_port, say
from benchmarks.rounds import resident_mb
from benchmarks.soak import Child
from transport import PausePhase, StancePause, open_client
from transport.stance_link import StanceReceiver

# [s] A message's way, and a link or a node that goes without a word: docs/safety.md.
GRACE_S = 3.0
# [s] Between two looks of a planner; longest stop of a process, and of the wait for the first scan.
LOOK_S, STOP_S, FIRST_S = 0.2, 6.0, 300.0
# Shares of the time: until the first the node is killed; from the second on its size counts, from the third others'.
KILLS_END, NODE_WARM, WARM = 1 / 2, 2 / 3, 1 / 3
# What a process that lives on may gain from the first third of its looks to the last, once it is warm: a viewer keeps
# 60 pauses of 1 to 2 MB, and a node draws and keeps the pictures of a scan in some 200 MB that come and go.
MOST_MB, MOST_HANDLES, MOST_THREADS = {"router": 40.0, "planner": 40.0, "viewer": 150.0, "node": 150.0}, 4, 4


@dataclass(frozen=True, slots=True)
class Size:
    """Memory [MB], open handles and threads of a process."""

    memory: float
    handles: int
    threads: int

    @classmethod
    def of(cls, pid: int) -> Size:
        """Those of a living process."""
        handles, threads = (len(list(Path(f"/proc/{pid}/{name}").iterdir())) for name in ("fd", "task"))
        return cls(resident_mb(pid), handles, threads)

    def __str__(self) -> str:
        """As in the report."""
        return f"{self.memory:.0f} MB, {self.handles} handles, {self.threads} threads"

    @classmethod
    def middle(cls, sizes: Sequence[Size]) -> Size:
        """Median of each."""
        memory, handles, threads = zip(*((each.memory, each.handles, each.threads) for each in sizes), strict=True)
        return cls(median(memory), round(median(handles)), round(median(threads)))

    def is_flat_until(self, last: Size, most_mb: float) -> bool:
        """Whether a later size is no larger but for what caches take."""
        return (
            last.memory - self.memory <= most_mb
            and last.handles - self.handles <= MOST_HANDLES
            and last.threads - self.threads <= MOST_THREADS
        )


@dataclass(slots=True)
class Outcome:
    """Result of a run: faults, counts of the planners, sizes of processes that live on, once warm, and of journals."""

    faults: Counter[str] = field(default_factory=Counter)
    counts: Counter[str] = field(default_factory=Counter)
    sizes: dict[str, list[Size]] = field(default_factory=dict)
    recorded: int = 0
    journals: dict[str, int] = field(default_factory=dict)

    def ends(self, name: str) -> tuple[Size, Size]:
        """Median sizes of a process in the first and in the last third of its looks."""
        sizes = self.sizes[name]
        third = max(len(sizes) // 3, 1)
        return Size.middle(sizes[:third]), Size.middle(sizes[-third:])

    @property
    def is_flat(self) -> bool:
        """Whether no process that lived on has grown."""
        return all(first.is_flat_until(last, MOST_MB[name]) for name in self.sizes for first, last in [self.ends(name)])


def run_planner(endpoint: str) -> None:
    """A planner that takes each grid of both extents and tells contradictions; prints its counts twice a second."""
    counts: Counter[str] = Counter()
    heard: list[tuple[float, str, int]] = []

    def on_pause(pause: StancePause) -> None:
        if pause.phase is PausePhase.BEGIN:
            heard.append((time.monotonic(), pause.epoch, pause.step))
            del heard[:-20]

    stop = ended()
    with open_client(endpoint, timeout=PATIENCE) as session, gp.TerrainClient(endpoint, timeout=PATIENCE) as client:
        StanceReceiver(session, robot="guara", on_pause=on_pause, on_refused=lambda _: None)
        say(ready=True)
        taken: dict[str, int] = {}
        while not stop.wait(LOOK_S):
            for extent in ("footprint", "map"):
                try:
                    terrain = client.latest(extent=extent)
                except (gp.StaleTerrain, gp.ScannerUnavailable):
                    counts[f"{extent} withheld"] += 1
                    continue
                counts[f"{extent} handed out"] += 1
                counts["out of order"] += terrain.stamp < taken.get(extent, 0)
                counts[f"new {extent}s"] += terrain.stamp > taken.get(extent, 0)
                taken[extent] = terrain.stamp
                settled = [each for each in heard if time.monotonic() - each[0] > GRACE_S]
                # A BEGIN may be lost while a node starts: a pause that was never heard of is not known to be over.
                pauses = [(epoch, step) for _, epoch, step in heard]
                over = {*pauses[: max(len(settled) - 1, 0)]} - {*pauses[max(len(settled) - 1, 0) :]}
                if extent == "footprint" and (terrain.metadata["epoch"], terrain.step) in over:
                    counts["contradictions"] += 1
                    said = f"{terrain.metadata['epoch']} step {terrain.step}"
                    print(f"contradiction: {said} handed out, heard: {heard[-3:]}", file=sys.stderr, flush=True)
            say(counts=counts)


class Machine:
    """The processes of a run, in a folder."""

    def __init__(self, folder: Path) -> None:
        """Start all of them; wait until the first planner has a grid."""
        self._folder, self._endpoint = folder, free_endpoint()
        self._log = (folder / "log.txt").open("w")
        self.router = Child("router", self._endpoint)
        self.node = self.start_node()
        self.lasting, self.other = self.start_planner(), self.start_planner()
        view = ["view", "--connect", self._endpoint, "--port", str(free_port())]
        self.viewer = self._program(view)

    def _program(self, arguments: list[str]) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "guara_perception.app.main", *arguments]
        return subprocess.Popen(command, cwd=ROOT, stdout=self._log, stderr=self._log, stdin=subprocess.DEVNULL)

    def start_node(self) -> subprocess.Popen[bytes]:
        """A node that walks by itself and records."""
        folder = self._folder / "recorded"
        folder.mkdir(exist_ok=True)
        options = ["--mode", "coarse", "--connect", self._endpoint, "--record", str(folder), "--record-limit", "2GB"]
        return self._program(["run", "--simulated", *options, "--state", str(self._folder / "state")])

    def start_planner(self) -> Child:
        """A planner."""
        return Child("planner", self._endpoint, module="endurance")

    def sizes(self) -> dict[str, Size]:
        """Sizes of the processes that live on, and of the node."""
        router, planner = self.router.popen.pid, self.lasting.popen.pid
        living = {"router": router, "planner": planner, "viewer": self.viewer.pid, "node": self.node.pid}
        return {name: Size.of(pid) for name, pid in living.items()}

    def close(self) -> None:
        """End all."""
        for process in (self.node, self.viewer):
            process.kill()
            process.wait()
        for child in (self.lasting, self.other, self.router):
            child.end()
        self._log.close()


def _strike(machine: Machine, fault: str, chance: random.Random, counts: Counter[str]) -> None:
    if fault == "node killed":
        machine.node.kill()
        machine.node.wait()
        machine.node = machine.start_node()
    elif fault == "planner killed":
        counts += machine.other.kill()
        machine.other = machine.start_planner()
    else:
        process = machine.node if fault == "node stopped" else machine.other.popen
        process.send_signal(signal.SIGSTOP)
        time.sleep(chance.uniform(1.0, STOP_S))
        process.send_signal(signal.SIGCONT)


FAULTS = "node killed", "node stopped", "planner killed", "planner stopped"


def endure(minutes: float, period: float, seed: int = 0, tell: Callable[[str], None] = lambda _: None) -> Outcome:
    """Run all processes for some minutes, with a fault about every `period` seconds."""
    chance, outcome = random.Random(seed), Outcome()
    with tempfile.TemporaryDirectory() as folder:
        machine = Machine(Path(folder))
        try:
            waiting = time.monotonic() + FIRST_S
            while not machine.lasting.last.get("counts", {}).get("new maps") and time.monotonic() < waiting:
                time.sleep(LOOK_S)
            begin = time.monotonic()
            while (gone := time.monotonic() - begin) < 60.0 * minutes:
                time.sleep(min(period * chance.uniform(0.5, 1.5), 60.0 * minutes - gone))
                share = (time.monotonic() - begin) / (60.0 * minutes)
                for name, size in machine.sizes().items():
                    if share >= (NODE_WARM if name == "node" else WARM):
                        outcome.sizes.setdefault(name, []).append(size)
                fault = chance.choice(FAULTS if share < KILLS_END else FAULTS[1:])
                outcome.faults[fault] += 1
                _strike(machine, fault, chance, outcome.counts)
                tell(f"{gone:6.0f} s  {fault:<16} {'; '.join(f'{n}: {s}' for n, s in machine.sizes().items())}")
            outcome.counts += Counter(machine.lasting.last.get("counts", {}))
            outcome.counts += Counter(machine.other.last.get("counts", {}))
            outcome.recorded = len(list((Path(folder) / "recorded").glob("*.mcap")))
            outcome.journals = {path.name: path.stat().st_size for path in (Path(folder) / "state").iterdir()}
        finally:
            machine.close()
    return outcome


def main() -> None:
    """Command line."""
    asked = options(__doc__, minutes=(240.0, "how long"), period=(20.0, "[s] between two faults, on average"))
    outcome = endure(asked.minutes, asked.period, tell=lambda line: print(line, flush=True))
    print(f"faults: {dict(outcome.faults)}; {outcome.recorded} recordings; bytes of journals: {outcome.journals}")
    print("counts of all planners:", ", ".join(f"{name} {count}" for name, count in sorted(outcome.counts.items())))
    for name, sizes in outcome.sizes.items():
        most = max(size.memory for size in sizes)
        first, last = outcome.ends(name)
        print(f"{name}: {first}, {last} in the first and last third of {len(sizes)} looks; at most {most:.0f} MB")
    print(f"contradictions: {outcome.counts['contradictions']}, out of order: {outcome.counts['out of order']}")
    is_sound = outcome.is_flat and not outcome.counts["contradictions"] and not outcome.counts["out of order"]
    sys.exit(0 if is_sound and outcome.counts["new maps"] else 1)


if __name__ == "__main__":
    main()
