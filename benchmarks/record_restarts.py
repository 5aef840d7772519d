"""Recording nodes that are killed repeatedly: how many restart, and which of their files can be opened.

Usage: python -m benchmarks.record_restarts [--restarts 20] [--pauses 3] [--limit 200MB]

`guara run --simulated --lossless --record FOLDER --record-limit LIMIT` is ended by kill -9 after a few pauses, at a
random instant, and started again; the last one is ended by Ctrl-C. Lossless frames fill a file in a pause or two, so
that files change and the oldest go. After each end every new file is opened: a finished one as it is, by
`gp.open_recording` and by the mcap library; a cut one recovered first. One that does not open ends the program.
"""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from mcap.reader import NonSeekingReader, make_reader

import guara_perception as gp
from benchmarks.command import options
from benchmarks.peers import free_endpoint
from guara_perception.app.files.recording_files import RecordingFiles, read_limit
from transport.recording import recover_recording

# How long a node may take to its next pause, on a busy machine [s].
PATIENCE_S = 120.0


def run_once(arguments: list[str], pauses: int, moment: float, end: signal.Signals) -> str:
    """Start a node and end it `moment` [s] after some pauses; return its output if it did not come up, else ""."""
    command = [sys.executable, "-m", "guara_perception.app.main", "run", "--simulated", *arguments]
    # The output goes to a file, because a pipe that is not read would block the node.
    with tempfile.TemporaryFile("w+") as said, subprocess.Popen(command, stdout=said, stderr=said) as node:
        until = time.monotonic() + PATIENCE_S * pauses
        printed = ""
        while printed.count("\nstep ") < pauses and node.poll() is None and time.monotonic() < until:
            time.sleep(0.1)
            said.seek(0)
            printed = said.read()
        time.sleep(moment)
        node.send_signal(end)
        node.wait(PATIENCE_S)
    return "" if printed.count("\nstep ") >= pauses else printed or "it said nothing"


def scans_of(path: Path) -> int:
    """Whole scans of a file, after every message, grid and frame of it was read by two readers."""
    with path.open("rb") as file:
        total = sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())
        file.seek(0)
        assert total == sum(1 for _ in NonSeekingReader(file, validate_crcs=True).iter_messages())
    with gp.open_recording(path) as recording:
        assert recording.calibration is not None
        for extent in ("footprint", "map"):
            assert all(terrain.shape for terrain in recording.grids(extent))
        return sum(len(list(scan.frames())) > 0 for scan in recording.scans)


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        restarts=(20, "nodes that are killed; at most 100"),
        pauses=(3, "pauses of each before; 1 to 30"),
        limit=("200MB", "--record-limit"),
    )
    chance, restarts, pauses = random.Random(0), min(asked.restarts, 100), max(1, min(asked.pauses, 30))
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place, "recordings")
        limit = read_limit(asked.limit, folder)
        foreign = Path(place, "recordings", "guara-notes.mcap")
        folder.mkdir()
        foreign.write_text("mine")
        arguments = ["--listen", free_endpoint(), "--lossless"]
        arguments += ["--record", str(folder), "--record-limit", asked.limit]
        came_up, largest = 0, 0
        finished: dict[Path, int] = {}
        recovered: dict[Path, int] = {}
        for number in range(restarts + 1):
            is_last = number == restarts
            moment, end = (0.0, signal.SIGINT) if is_last else (chance.uniform(0.0, 3.0), signal.SIGKILL)
            why = run_once(arguments, pauses, moment, end)
            if why:
                print(f"did not come up: {why}")
            came_up += not why and not is_last
            largest = max(largest, sum(path.stat().st_size for path in folder.iterdir()))
            cut = RecordingFiles(folder, "guara").cut()
            finished |= {path: scans_of(path) for path in {*folder.iterdir()} - {*finished, *cut, foreign}}
            for path in set(cut) - set(recovered):
                whole = Path(place, path.name)
                recover_recording(path, whole)
                recovered[path] = scans_of(whole)
                whole.unlink()
        kept = foreign.read_text() == "mine"
        made = max(int(path.stem[-6:]) for path in [*finished, *recovered])
        left = len(list(folder.iterdir())) - kept
    print(f"restarts {came_up} of {restarts}")
    print(f"files: {made} made, {made - left} of them removed, the oldest first")
    print(f"finished files opened: {len(finished)}, none failed, {sum(finished.values())} scans in them")
    print(f"cut files recovered: {len(recovered)}, none failed, {sum(recovered.values())} scans in them")
    print(f"most after a kill: {largest / 1e6:.0f} MB of {limit / 1e6:.0f}; foreign file kept: {kept}")
    sys.exit(0 if came_up == restarts and not why and kept and largest <= limit else 1)


if __name__ == "__main__":
    main()
