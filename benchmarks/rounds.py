"""Alternating runs of contenders, compared round by round, since only ratios are reliable on a shared machine."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

Clock = Callable[[], float]
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Ratio:
    """Median, smallest and largest of the ratios of all rounds."""

    median: float
    low: float
    high: float

    def __format__(self, form: str) -> str:
        """As in the tables: median [min max]."""
        return format(f"{number(self.median)} [{number(self.low)} {number(self.high)}]", form)


@dataclass(frozen=True, slots=True)
class Timings:
    """Seconds of each contender in each round it took part in.

    Attributes:
        seconds: contender -> round -> seconds.
        results: contender -> what it returned last.
    """

    seconds: Mapping[str, Mapping[int, float]]
    results: Mapping[str, Any] = field(default_factory=dict)

    def milliseconds(self, name: str, per: int = 1) -> float:
        """Median over the rounds."""
        return 1e3 * float(np.median(list(self.seconds[name].values()))) / per

    def ratio(self, name: str, to: str) -> Ratio:
        """Ratio of the seconds to those of another contender, in the rounds of both."""
        own, other = self.seconds[name], self.seconds[to]
        ratios = [own[round_number] / max(other[round_number], 1e-9) for round_number in own if round_number in other]
        return Ratio(float(np.median(ratios)), min(ratios), max(ratios))


def in_turns(names: Iterable[str], rounds: int) -> Iterator[tuple[int, str]]:
    """Number of the round and name of each run; who begins changes from round to round."""
    order = list(names)
    for number in range(rounds):
        shift = number % len(order)
        for name in order[shift:] + order[:shift]:
            yield number, name


def alternate(
    contenders: Mapping[str, Callable[[], object]],
    rounds: int,
    *,
    clock: Clock = time.process_time,
    slow: Collection[str] = (),
    slow_rounds: int = 1,
    warm: bool = True,
) -> Timings:
    """Run every contender once per round, in turns.

    Args:
        contenders: by name.
        rounds: number of rounds.
        clock: CPU time of the process (for totals) or wall time (for latency).
        slow: names of those that take part in the first `slow_rounds` rounds only, and are not warmed up.
        slow_rounds: number of rounds in which these take part.
        warm: whether each is run once before the first round.
    """
    seconds: dict[str, dict[int, float]] = {name: {} for name in contenders}
    results: dict[str, Any] = {}
    for name in contenders if warm else ():
        if name not in slow:
            contenders[name]()
    for round_number, name in in_turns(contenders, rounds):
        if name not in slow or round_number < slow_rounds:
            gc.collect()
            start = clock()
            results[name] = contenders[name]()
            seconds[name][round_number] = clock() - start
    return Timings(seconds, results)


def number(value: float) -> str:
    """Three significant digits, no exponents."""
    if not np.isfinite(value):
        return "-"
    if value == 0:
        return "0"
    digits = max(0, 2 - int(np.floor(np.log10(abs(value)))))
    return f"{value:.{min(digits, 3)}f}"


def resident_mb(process: int | str = "self", field: str = "VmRSS") -> float:
    """Resident memory of a process, now ("VmRSS") or at its peak ("VmHWM") [MB of 2^20 bytes]."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith(field)) / 1024


def peak_growth(run: Callable[[], Result]) -> tuple[Result, float]:
    """A result, and growth of this process's peak memory while it was computed [MB of 2^20 bytes]."""
    # Reset Linux's record of the peak.
    Path("/proc/self/clear_refs").write_text("5")
    before = resident_mb(field="VmHWM")
    return run(), resident_mb(field="VmHWM") - before


def timed(run: Callable[[], Result]) -> tuple[Result, float]:
    """A result and the processor time that it took [s]."""
    begun = time.process_time()
    result = run()
    return result, time.process_time() - begun
