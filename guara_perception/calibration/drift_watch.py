"""`DriftWatch`: what the drift checks of several pauses say together."""

from __future__ import annotations

from collections import Counter, deque

from guara_perception.calibration.drift import DRIFTING, HOLDS, UNKNOWN, Drift

# The newest scans that showed a floor, and how many of them must show drift: a threshold of the floor, or a bump along
# one stripe, is seen by other stripes at the next pause.
REMEMBERED = 3
NEEDED = 2


class DriftWatch:
    """Follows the drift checks of a walk; what a single floor shows by chance is no warning yet.

    Example:
        watch = DriftWatch()
        watch.add(check_drift(points, covariance, soles))
        if watch.verdict == "drifting": ...
    """

    def __init__(self) -> None:
        """Start with no scan."""
        self._with_floor: deque[Drift] = deque(maxlen=REMEMBERED)
        self._counts: Counter[str] = Counter()

    def add(self, drift: Drift) -> None:
        """Take the check of the next pause; one that showed no floor is counted and changes nothing."""
        self._counts[drift.verdict] += 1
        if drift.verdict != UNKNOWN:
            self._with_floor.append(drift)

    @property
    def verdict(self) -> str:
        """Whether two of the last three scans with a floor drift; "unknown" when no scan showed a floor."""
        if not self._with_floor:
            return UNKNOWN
        return DRIFTING if sum(drift.verdict == DRIFTING for drift in self._with_floor) >= NEEDED else HOLDS

    @property
    def counts(self) -> dict[str, int]:
        """Number of scans by their own verdict."""
        return {verdict: self._counts[verdict] for verdict in (HOLDS, DRIFTING, UNKNOWN)}
