"""Processor time of whole scans with this checkout and with another one, in turns.

`python -m benchmarks.scan_cost [--against FOLDER] [--scans DATA/scans/NAME ...] [--rounds N]`: FOLDER is a checkout of
another revision that has the folder `testbed` (`git worktree add --detach FOLDER REVISION`). Each checkout has a
process, and both use the packages installed in this environment. `light scans` shows where the time goes.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from benchmarks.command import options
from benchmarks.peers import ROOT, Peer
from benchmarks.rounds import Timings, in_turns

HERE, THERE = "this checkout", "the other one"
PEER = Path(__file__).with_name("scan_cost_peer.py")


class Checkout(Peer):
    """A process that scans with the code of one checkout when asked."""

    def __init__(self, folder: Path, scan: Path) -> None:
        """Start it.

        Args:
            folder: root of the checkout.
            scan: DATA/scans/NAME, as in `testbed.scenes.recorded`.

        Raises:
            SystemExit: the folder is no checkout of this project.
        """
        if not (folder / "guara_perception" / "__init__.py").is_file():
            raise SystemExit(f"scan_cost: {folder}: no checkout of guara_perception; allowed: its root folder")
        self._folder = folder
        # Without -P the folder of the peer's file would come first, and its modules hide packages of the same name.
        command = [sys.executable, "-P", str(PEER), str(scan.resolve())]
        super().__init__(command, cwd=folder, PYTHONPATH=str(folder.resolve()))

    def scan(self) -> float:
        """Scan once; return the processor time [s]."""
        with suppress(BrokenPipeError):
            self.send()
        found = self.receive()
        if not found:
            raise SystemExit(f"scan_cost: the scan with the code of {self._folder} failed; its error is printed above")
        return float(found["seconds"])


def measure(folders: Mapping[str, Path], scan: Path, rounds: int) -> Timings:
    """Processor time of every scan.

    Args:
        folders: root of each checkout by its name.
        scan: DATA/scans/NAME.
        rounds: number of scans of each, after a first one that does not count.
    """
    checkouts = {name: Checkout(folder, scan) for name, folder in folders.items()}
    seconds: dict[str, dict[int, float]] = {name: {} for name in checkouts}
    try:
        for checkout in checkouts.values():
            checkout.scan()
        for number, name in in_turns(checkouts, rounds):
            seconds[name][number] = checkouts[name].scan()
    finally:
        for checkout in checkouts.values():
            checkout.end()
    return Timings(seconds)


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        against=(Path, "root of a checkout of another revision"),
        scans=([ROOT / "tests" / "data" / "scans" / "paper"], "DATA/scans/NAME"),
        rounds=(11, "scans of each checkout"),
    )
    folders = {HERE: ROOT} | ({} if asked.against is None else {THERE: asked.against})
    for scan in asked.scans:
        timings = measure(folders, scan, max(asked.rounds, 1))
        print(f"{scan.parent.parent.name}/{scan.name}")
        for name in folders:
            print(f"  {name:14s} {timings.milliseconds(name):6.0f} ms a scan", flush=True)
        if THERE in folders:
            print(f"  processor time of a scan, this over the other: {timings.ratio(HERE, THERE)}", flush=True)


if __name__ == "__main__":
    main()
