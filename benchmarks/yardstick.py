"""Reference extraction as a measure of the machine's present speed."""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.contenders import over, reference
from guara_perception.arrays import Float
from testbed.scenes import recorded

# Time per stripe on the machine on which the limits were set. The product took 1.75 times as long: 0.57 ... 0.65 ms.
REFERENCE_STRIPE_S = 0.34e-3


class Yardstick:
    """The reference extraction over the bands of one recorded scan."""

    def __init__(self, scan: Path) -> None:
        """Read the scan.

        Args:
            scan: DATA/scans/NAME, as in `testbed.scenes.recorded`.
        """
        self._bands = recorded(scan).bands()
        self._extract = over(reference, self._bands)

    @property
    def stripes(self) -> int:
        """Number of its bands."""
        return len(self._bands)

    def seconds(self) -> float:
        """Processor time of this process for all bands, once."""
        gc.collect()
        start = time.process_time()
        self._extract()
        return time.process_time() - start


def beside(scans: Sequence[float], references: Sequence[float], stripes: int) -> list[str]:
    """Lines that compare scans with the reference, and estimate their cost on the machine on which the limits were set.

    Args:
        scans: (n,) processor time of each scan [s].
        references: (n + 1,) processor time of the reference before the first scan, between and after the last [s].
        stripes: number of stripes that the reference extracts.
    """
    taken, before_and_after = np.array(scans), np.array(references)
    ratio = taken / (0.5 * (before_and_after[:-1] + before_and_after[1:]))
    median = float(np.median(ratio))
    return [
        f"the same, min / median / max     {_summary(1e3 * taken, '.0f')} ms",
        f"{f'reference, {stripes} stripes':32} {_summary(1e3 * before_and_after, '.1f')} ms, before, between and after",
        f"scan / reference                 {_summary(ratio, '.2f')}",
        f"at the speed at which the reference takes {1e3 * REFERENCE_STRIPE_S:.2f} ms a stripe: "
        f"{1e3 * REFERENCE_STRIPE_S * stripes * median:.0f} ms per scan",
    ]


def _summary(values: Float, form: str) -> str:
    return " / ".join(f"{value:{form}}" for value in (values.min(), np.median(values), values.max()))
