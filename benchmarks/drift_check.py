"""Detection rate and false alarms of the drift check: true scans, moved mounts and lost motor steps in simulation.

`python -m benchmarks calibration drift [--scans N] [--walks N] [--json]`; about ten minutes of
processor time.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from benchmarks.command import Table, options
from guara_perception.calibration.drift import DRIFTING, HOLDS, UNKNOWN, Drift, DriftWatch
from testbed.moved_mount import PAUSES, walk

# Unit and sizes of each drift; the last size must be found.
SIZES = {
    "camera": ("degrees", (0.02, 0.05, 0.1, 0.2, 0.5)),
    "laser": ("degrees", (0.01, 0.02, 0.05, 0.1, 0.2)),
    "steps": ("steps", (1.0, 2.0, 4.0, 8.0, 16.0)),
}


@dataclass(slots=True)
class Tally:
    """Single scans by verdict, and walks of three pauses.

    Attributes:
        scans: number by verdict.
        walks: number in all.
        warned: walks in which the watch warned within three pauses.
        reasons: reasons of all scans judged as drifting, to be printed.
    """

    scans: dict[str, int] = field(default_factory=lambda: dict.fromkeys((HOLDS, DRIFTING, UNKNOWN), 0))
    walks: int = 0
    warned: int = 0
    reasons: list[str] = field(default_factory=list)

    def add(self, walk: Sequence[Drift]) -> None:
        """Count one walk."""
        watch, warned = DriftWatch(), False
        for drift in walk:
            self.scans[drift.verdict] += 1
            if drift.verdict == DRIFTING:
                self.reasons += drift.reasons
            watch.add(drift)
            warned |= watch.verdict == DRIFTING
        self.walks, self.warned = self.walks + 1, self.warned + warned


def tally(walks: int, first_seed: int, kind: str = "", size: float = 0.0, *, is_rough: bool = False) -> Tally:
    """Judge many walks; with a `kind`, each has a drift of that kind in a direction of its own."""
    result = Tally()
    for seed in range(first_seed, first_seed + walks):
        result.add(walk(seed, kind=kind, size=size, is_rough=is_rough))
    return result


def main() -> None:
    """Detection rate and false alarms of the drift check [--scans N, --walks N, --json]."""
    asked = options(
        __doc__,
        scans=(201, "true scans of a flat floor"),
        walks=(20, "walks of three pauses for each drift that must be found"),
        curve_walks=(5, "walks for each smaller drift"),
        json=(False, "one JSON object as the last line"),
    )
    curves: dict[str, list[dict[str, float]]] = {kind: [] for kind in SIZES}
    table = Table("drift:<24 | scans:d | holds:d | drifting:d | unknown:d | walks:d | warned in three pauses:.0%")

    def counted(name: str, walks: int, first_seed: int, *kind: Any, is_rough: bool = False) -> Tally:
        result = tally(walks, first_seed, *kind, is_rough=is_rough)
        verdicts = (result.scans[verdict] for verdict in (HOLDS, DRIFTING, UNKNOWN))
        table.row(name, sum(result.scans.values()), *verdicts, result.walks, result.warned / result.walks)
        print("".join(f"    {reason}\n" for reason in result.reasons), end="", flush=True)
        return result

    true_walks = -(-asked.scans // PAUSES)
    true = counted("none, flat floor", true_walks, 0)
    rough = counted("none, rough ground", -(-true_walks // 5), 5000, is_rough=True)
    for kind, (unit, sizes) in SIZES.items():
        for size in sizes:
            walks = asked.walks if size == sizes[-1] else asked.curve_walks
            result = counted(f"{kind} {size:g} {unit}", walks, 1000, kind, size)
            by_one = result.scans[DRIFTING] / sum(result.scans.values())
            found = result.warned / result.walks
            curves[kind].append({"level": size, "walks": walks, "found": found, "found_by_one": by_one})
    with_floor = true.scans[HOLDS] + true.scans[DRIFTING]
    alarms = (true.scans[DRIFTING] + rough.scans[DRIFTING]) / max(with_floor + rough.scans[DRIFTING], 1)
    passed = alarms <= 0.01 and all(points[-1]["found"] >= 0.9 for points in curves.values())
    print(f"false alarms {alarms:.1%} of {with_floor} scans with a floor (at most 1 %)")
    print("every limit is met" if passed else "a limit is NOT met")
    if asked.json:
        whole = {"true": true.scans, "rough": rough.scans, "false_alarms": alarms, "curves": curves, "passed": passed}
        print(json.dumps(whole))
    raise SystemExit(0 if passed else 1)
