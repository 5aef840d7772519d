"""Endurance test: hours of a walking gait, a recording node with a journal, two planners and a viewer, with faults.

`python -m benchmarks endurance [--minutes 240] [--period 20]`, after `make install-extras`. Each is a process
of its own over real Zenoh; robot and devices are simulated, the devices on an emulated clock, so that a pause takes no
longer than it is computed. Frames are small, cells 10 mm wide, and there is no indirect light. Node and second planner
are killed or stopped for a few seconds; the node's disk accepts no data for a few seconds; the node is ended and finds
journals of another version, as after an upgrade or a downgrade. Router, gait, first planner and viewer run throughout.
In the second half the node is not restarted, so that its own growth shows. At the end every recording is opened.
A contradiction is a footprint grid handed out more than 4 s after its planner heard of a later pause, or a map with
scans of another walk.
"""

from __future__ import annotations

import itertools
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

import guara_perception as gp
from benchmarks.command import options
from benchmarks.peers import PATIENCE, ROOT, Child, ended, free_endpoint, free_port, report, wait_for_map
from benchmarks.rounds import resident_mb
from guara_perception.app.files.recording_files import LEAST_LIMIT, RecordingFiles
from guara_perception.app.node.claim import FORMAT
from guara_perception.app.node.simulated import SimulatedGait
from guara_perception.simulation.walk import simulate_walk
from kinematics import load_robot
from testbed.altered_robot import altered_guara
from testbed.journalled_node import Walk, start
from testbed.random_world import random_world
from transport import PausePhase, StancePause, open_client
from transport.grids.evidence import SILENT
from transport.recording import recover_recording
from transport.stance_link import StancePublisher, StanceReceiver

# [s] Transfer of a message on a busy machine, and detection of a silent link or node (docs/safety.md).
GRACE_S = 1.0 + SILENT
# [s] Between two requests of a planner; longest stop of a process, and of the wait for a scan.
LOOK_S, STOP_S, FIRST_S = 0.2, 6.0, 300.0
# Size of frames [px], and cycles of a walk, after which the robot is carried back.
SIZE, CYCLES = (320, 256), 10
# Edge of a cell [m]. With cells of 5 mm, a pause takes twice as long.
CELL = 0.010
# [byte] Largest file while the disk takes no more: a journal has more.
FULL = 300_000
# Formats of journals of the versions before and after this one.
OTHER_FORMATS = "guara-journal/0", "guara-journal/2"
# [byte] Two journals and one that is being written; recordings over their limit while a file is begun.
MOST_JOURNALS, MOST_RECORDED = 12_000_000, round(1.3 * LEAST_LIMIT)
# Shares of the time: until the first the node is killed; from the second on its size counts, from the third others'.
KILLS_END, NODE_WARM, WARM = 1 / 2, 2 / 3, 1 / 3
# Allowed growth of a process from the first to the last third of its samples, after warm-up. A viewer keeps 60 pauses
# of 1 to 2 MB; a node temporarily uses some 200 MB for the pictures of a scan.
MOST_MB, MOST_HANDLES, MOST_THREADS = {"router": 40.0, "planner": 40.0, "viewer": 150.0, "node": 150.0}, 4, 4


class Size(NamedTuple):
    """Memory [MB], open handles and threads of a process."""

    memory: float
    handles: float
    threads: float

    @classmethod
    def of(cls, pid: int) -> Size:
        """Those of a living process."""
        handles, threads = (len(list(Path(f"/proc/{pid}/{name}").iterdir())) for name in ("fd", "task"))
        return cls(resident_mb(pid), handles, threads)

    def __str__(self) -> str:
        """As in the report."""
        return f"{self.memory:.0f} MB, {self.handles:.0f} handles, {self.threads:.0f} threads"


@dataclass(slots=True)
class Outcome:
    """Result of a run.

    Attributes:
        faults: number of each.
        counts: of planners and gait.
        sizes: of processes that live on, once warm.
        recorded, journals: [byte] of both folders at each sample.
        restarts: how each run of the node began: "goes on", or why not.
    """

    faults: Counter[str] = field(default_factory=Counter)
    counts: Counter[str] = field(default_factory=Counter)
    sizes: dict[str, list[Size]] = field(default_factory=dict)
    recorded: list[int] = field(default_factory=list)
    journals: list[int] = field(default_factory=list)
    restarts: Counter[str] = field(default_factory=Counter)

    def ends(self, name: str) -> tuple[Size, Size]:
        """Median sizes of a process in the first and in the last third of its samples."""
        sizes = self.sizes[name]
        third = max(len(sizes) // 3, 1)
        first, last = (Size(*np.median(part, axis=0).tolist()) for part in (sizes[:third], sizes[-third:]))
        return first, last

    @property
    def is_bounded(self) -> bool:
        """True if journals and recordings stayed within their limits."""
        return max(self.journals, default=0) <= MOST_JOURNALS and max(self.recorded, default=0) <= MOST_RECORDED

    @property
    def is_flat(self) -> bool:
        """True if no process that lived on has grown by more than its caches."""
        growths = {name: np.subtract(*self.ends(name)[::-1]) for name in self.sizes}
        return all((growths[name] <= (MOST_MB[name], MOST_HANDLES, MOST_THREADS)).all() for name in growths)


def run_planner(endpoint: str) -> None:
    """Planner that requests grids of both extents, counts contradictions, and prints its counts five times a second."""
    counts: Counter[str] = Counter()
    heard: list[tuple[float, str, int]] = []

    def on_pause(pause: StancePause) -> None:
        if pause.phase is PausePhase.BEGIN:
            heard.append((time.monotonic(), pause.epoch, pause.step))
            del heard[:-20]

    stop = ended()
    with open_client(endpoint, timeout=PATIENCE) as session, gp.TerrainClient(endpoint, timeout=PATIENCE) as client:
        StanceReceiver(session, robot="guara", on_pause=on_pause, on_refused=lambda _: None)
        report(ready=True)
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
                    late = time.monotonic() - next(at for at, _, step in heard if step > terrain.step)
                    print(f"contradiction: step {terrain.step} {late:.2f} s after the next", file=sys.stderr)
            report(counts=counts)


class Gait(threading.Thread):
    """Gait that walks while nodes restart, and stands at each pause until there is a map."""

    def __init__(self, endpoint: str, walk: Walk, outcome: Outcome) -> None:
        """Connect; `start` begins the first walk."""
        super().__init__(daemon=True)
        self._endpoint, self._walk, self._outcome, self._ended = endpoint, walk, outcome, threading.Event()

    def run(self) -> None:
        """Walk until `end` is called. All walks are the same; the robot is carried back between them."""
        counts, before = self._outcome.counts, ""
        with open_client(self._endpoint, timeout=PATIENCE) as session, gp.TerrainClient(self._endpoint) as client:
            publisher = StancePublisher(session)
            for number in itertools.count():
                gait = SimulatedGait(publisher, "guara", seed=number)
                for pause in self._walk.pauses:
                    gait.begin(pause)
                    fused = wait_for_map(client, pause.step, FIRST_S, self._is_ended, epoch=gait.epoch)
                    if fused is None:
                        counts["walks that ended"] += not self._ended.is_set()
                        return
                    counts["pauses"] += 1
                    counts["contradictions"] += fused.metadata["scans"] > pause.step + 1
                    run = fused.metadata["run"]
                    if before not in ("", run):
                        self._outcome.restarts[_how(fused, pause.step)] += 1
                    before = run
                    gait.end(pause)

    def _is_ended(self) -> bool:
        return self._ended.wait(LOOK_S / 10)

    def end(self) -> None:
        """End the walk, within the pause."""
        self._ended.set()
        self.join()


def _how(fused: gp.TerrainGrid, step: int) -> str:
    """Start of a restarted node, by its first map: the walk goes on, or the reason why not."""
    if fused.metadata["scans"] > 1:
        return "goes on"
    return "begins with the walk" if step == 0 else (*fused.metadata["restarts"], "no journal")[0].split(":")[0]


class Machine:
    """The processes of a run, in a folder."""

    def __init__(self, folder: Path, outcome: Outcome) -> None:
        """Start all of them."""
        self.folder, self._endpoint, self.port = folder, free_endpoint(), free_port()
        self._log = (folder / "log.txt").open("w")
        world = random_world(0)
        # Indirect light costs an eighth of the time, and only the simulation knows of it.
        world = replace(world, light=replace(world.light, bounce=0.0))
        robot = altered_guara(folder, ("resolution = 0.005 ", f"resolution = {CELL} "))
        walk = Walk(world, 0, tuple(simulate_walk(world, load_robot(robot), cycles=CYCLES, seed=0)), SIZE, robot)
        walk.save(folder / "walk")
        self.router = Child("router", self._endpoint)
        self.node = self.start_node()
        self.lasting, self.other = self.start_planner(), self.start_planner()
        view = ["-m", "guara_perception.app.main", "view", "--connect", self._endpoint, "--port", str(free_port())]
        self.viewer = subprocess.Popen(
            [sys.executable, *view], cwd=ROOT, stdout=self._log, stderr=self._log, stdin=subprocess.DEVNULL
        )
        self.gait = Gait(self._endpoint, walk, outcome)
        self.gait.start()

    def start_node(self) -> subprocess.Popen[str]:
        """A node that records, keeps a journal and serves metrics."""
        state, log = self.folder / "state", self.folder / "log.txt"
        return start(self._endpoint, state, self.folder / "walk", log, self.folder / "recorded", self.port)

    def start_planner(self) -> Child:
        """A planner."""
        return Child("planner", self._endpoint, module="endurance")

    def restart_node(self, *, is_clean: bool) -> None:
        """Restart the node; if `is_clean`, end it cleanly and replace its journals by ones of another version."""
        if is_clean:
            self.node.communicate(timeout=PATIENCE)
        self.node.kill()
        self.node.wait()
        if is_clean:
            for number, path in enumerate((self.folder / "state").glob("*.journal")):
                content = path.read_bytes().removeprefix(FORMAT.encode())
                path.write_bytes(OTHER_FORMATS[number % 2].encode() + content)
        self.node = self.start_node()

    def fill_disk(self, seconds: float) -> None:
        """Prevent the node's files from growing for some time [s]."""
        limits = resource.prlimit(self.node.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(self.node.pid, resource.RLIMIT_FSIZE, (FULL, limits[1]))
        time.sleep(seconds)
        resource.prlimit(self.node.pid, resource.RLIMIT_FSIZE, limits)

    def sizes(self) -> dict[str, Size]:
        """Sizes of the lasting processes and of the node."""
        router, planner = self.router.popen.pid, self.lasting.popen.pid
        living = {"router": router, "planner": planner, "viewer": self.viewer.pid, "node": self.node.pid}
        return {name: Size.of(pid) for name, pid in living.items()}

    def look(self, outcome: Outcome) -> None:
        """Record the disk usage, and read the metrics."""
        for name, noted in (("recorded", outcome.recorded), ("state", outcome.journals)):
            total = 0
            for path in (self.folder / name).glob("*"):
                with suppress(FileNotFoundError):
                    total += path.stat().st_size
            noted.append(total)
        # A node that is just starting serves no metrics yet.
        with suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{self.port}/metrics", timeout=5.0) as answer:
            outcome.counts["metrics read"] += b"guara_journal_written" in answer.read()

    def close(self) -> None:
        """End all."""
        self.gait.end()
        for process in (self.node, self.viewer):
            process.kill()
            process.wait()
        for child in (self.lasting, self.other, self.router):
            child.end()
        self._log.close()


def _strike(machine: Machine, fault: str, chance: random.Random, counts: Counter[str]) -> None:
    if fault in ("node killed", "other version"):
        machine.restart_node(is_clean=fault == "other version")
    elif fault == "planner killed":
        machine.other.end()
        counts += machine.other.counts
        machine.other = machine.start_planner()
    elif fault == "disk full":
        machine.fill_disk(chance.uniform(1.0, STOP_S))
    else:
        process = machine.node if fault == "node stopped" else machine.other.popen
        process.send_signal(signal.SIGSTOP)
        time.sleep(chance.uniform(1.0, STOP_S))
        process.send_signal(signal.SIGCONT)


def opened_files(folder: Path) -> Counter[str]:
    """Counts of finished recordings, of cut ones that were recovered, and of scans whose frames were all read.

    Raises:
        FileFormatError, RecordingError: a file cannot be opened or recovered.
    """
    counts, cut = Counter[str](), RecordingFiles(folder, "guara").cut()
    for path in sorted(folder.iterdir()):
        whole = path
        if path in cut:
            whole = folder.parent / path.name
            recover_recording(path, whole)
        counts["files recovered" if path in cut else "files opened"] += 1
        with gp.open_recording(whole) as recording:
            counts["scans in files"] += sum(len(list(scan.frames())) > 0 for scan in recording.scans)
    return counts


# The faults that end the node come first.
FAULTS = "node killed", "other version", "node stopped", "disk full", "planner killed", "planner stopped"


def endure(minutes: float, period: float, seed: int = 0) -> Outcome:
    """Run all processes for a few minutes, with a fault about every `period` seconds; print a line at each."""
    chance, outcome = random.Random(seed), Outcome()
    with tempfile.TemporaryDirectory() as folder:
        machine = Machine(Path(folder), outcome)
        try:
            waiting = time.monotonic() + FIRST_S
            while not machine.lasting.counts["new maps"] and time.monotonic() < waiting:
                time.sleep(LOOK_S)
            begin = time.monotonic()
            while (gone := time.monotonic() - begin) < 60.0 * minutes:
                time.sleep(min(period * chance.uniform(0.5, 1.5), 60.0 * minutes - gone))
                share = (time.monotonic() - begin) / (60.0 * minutes)
                sizes = machine.sizes()
                for name, each in sizes.items():
                    if share >= (NODE_WARM if name == "node" else WARM):
                        outcome.sizes.setdefault(name, []).append(each)
                machine.look(outcome)
                drawn = chance.choice(FAULTS if share < KILLS_END else FAULTS[2:])
                # Each fault once, in order, then at random.
                fault = next((each for each in FAULTS if not outcome.faults[each]), drawn)
                outcome.faults[fault] += 1
                _strike(machine, fault, chance, outcome.counts)
                wrong = outcome.counts["contradictions"] + machine.lasting.counts["contradictions"]
                pauses = f"{outcome.counts['pauses']} pauses, {wrong} contradictions"
                of_processes = "; ".join(f"{name}: {size}" for name, size in sizes.items())
                print(f"{gone:6.0f} s  {pauses}  {fault:<16} {of_processes}", flush=True)
        finally:
            machine.close()
        outcome.counts += machine.lasting.counts + machine.other.counts + opened_files(machine.folder / "recorded")
    return outcome


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        minutes=(240.0, "how long"),
        period=(20.0, "[s] between two faults, on average"),
    )
    outcome = endure(asked.minutes, asked.period)
    print(f"faults: {dict(outcome.faults)}; {outcome.counts['pauses']} pauses in {asked.minutes:g} minutes")
    print(f"{outcome.restarts.total()} restarts survived: {dict(outcome.restarts)}")
    print("counts:", ", ".join(f"{name} {count}" for name, count in sorted(outcome.counts.items())))
    for name, sizes in outcome.sizes.items():
        most = max(each.memory for each in sizes)
        first, last = outcome.ends(name)
        print(f"{name}: {first}, {last} in the first and last third of {len(sizes)} samples; at most {most:.0f} MB")
    recorded, journals = max(outcome.recorded) / 1e6, max(outcome.journals) / 1e6
    print(f"disk: recordings {recorded:.0f} MB at most (limit {LEAST_LIMIT / 1e6:.0f}), journals {journals:.1f} MB")
    print(f"contradictions: {outcome.counts['contradictions']}, out of order: {outcome.counts['out of order']}")
    is_sound = outcome.is_flat and outcome.is_bounded and not outcome.counts["walks that ended"]
    is_sound &= not outcome.counts["contradictions"] and not outcome.counts["out of order"]
    sys.exit(0 if is_sound and outcome.counts["new maps"] else 1)


if __name__ == "__main__":
    main()
