"""Processor time of whole scans and of their stripes, with this checkout and with another one.

`python -m benchmarks.scan_cost [--against FOLDER] [--scans DATA/scans/NAME ...] [--rounds N]`: FOLDER is a checkout of
another revision that has the folder `testbed` (`git worktree add --detach FOLDER REVISION`). Each checkout has a
process; they scan alternately, and the other one begins in every second round. Both use the packages installed in this
environment.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.command import options
from benchmarks.peers import Peer
from benchmarks.rounds import Timings

ROOT = Path(__file__).resolve().parents[1]
HERE, THERE = "this checkout", "the other one"
PEER = Path(__file__).with_name("scan_cost_peer.py")


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of the scans of one checkout.

    Attributes:
        scan_ms: median processor time of a scan [ms].
        stripes: number of stripes of a scan.
        strong: number of them that the highest peaks did not show, so that they were followed in any light.
        cheap_ms, strong_ms: median processor time of a stripe that the highest peaks show, and of one that was followed
            in any light [ms]; NaN where there is none.
    """

    scan_ms: float
    stripes: int
    strong: int
    cheap_ms: float
    strong_ms: float

    def __str__(self) -> str:
        """One line of the table."""
        share = f"{self.strong} of {self.stripes} stripes ({self.strong / max(self.stripes, 1):.0%}) in any light"
        times = f"{self.cheap_ms:.2f} ms a stripe by its highest peaks"
        if self.strong:
            times += f", {self.strong_ms:.1f} ms one in any light"
        return f"{self.scan_ms:6.0f} ms a scan, {share}; {times}"


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

    def scan(self) -> dict[str, Any]:
        """Scan once; the report of `scan_cost_peer`: seconds of the scan and of its stripes, by how they were found."""
        with suppress(BrokenPipeError):
            self.tell()
        found = self.hear()
        if not found:
            raise SystemExit(f"scan_cost: the scan with the code of {self._folder} failed; its error is printed above")
        return found


def measure(folders: Mapping[str, Path], scan: Path, rounds: int) -> tuple[dict[str, Cost], Timings]:
    """The cost of a scan by name of the checkout, and the seconds of every scan.

    Args:
        folders: root of each checkout by its name.
        scan: DATA/scans/NAME.
        rounds: number of scans of each, after a first one that does not count.
    """
    checkouts = {name: Checkout(folder, scan) for name, folder in folders.items()}
    names = list(checkouts)
    found: dict[str, dict[int, dict[str, Any]]] = {name: {} for name in names}
    try:
        for checkout in checkouts.values():
            checkout.scan()
        for round_number in range(rounds):
            for name in names if round_number % 2 == 0 else names[::-1]:
                found[name][round_number] = checkouts[name].scan()
    finally:
        for checkout in checkouts.values():
            checkout.end()
    seconds = {
        name: {number: float(report["scan"]) for number, report in scans.items()} for name, scans in found.items()
    }
    timings = Timings(seconds)
    return {name: _cost(timings.milliseconds(name), list(scans.values())) for name, scans in found.items()}, timings


def _cost(scan_ms: float, scans: list[dict[str, Any]]) -> Cost:
    stripes = int(scans[0]["stripes"])
    cheap, strong = ([value for scan in scans for value in scan[kind]] for kind in ("cheap", "strong"))
    cheap_ms, strong_ms = (1e3 * float(np.median(values)) if values else float("nan") for values in (cheap, strong))
    return Cost(scan_ms, stripes, len(strong) // len(scans), cheap_ms, strong_ms)


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
        costs, timings = measure(folders, scan, max(asked.rounds, 1))
        print(f"{scan.parent.parent.name}/{scan.name}")
        for name, cost in costs.items():
            print(f"  {name:14s} {cost}", flush=True)
        if THERE in costs:
            print(f"  processor time of a scan, this over the other: {timings.ratio(HERE, THERE)}", flush=True)


if __name__ == "__main__":
    main()
