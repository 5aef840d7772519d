"""How long a message that was announced is waited for before it is asked for."""

from __future__ import annotations

# [s] Longest wait, also while nothing is known of the link yet, and shortest: a machine may be busy for a short time.
LONGEST, SHORTEST = 0.3, 0.02
# A message is taken as lost after this multiple of the largest lateness of those before.
MARGIN = 4.0
# Share of the largest lateness that is kept with each message.
KEPT = 0.9


class Patience:
    """Learns how late messages come that come by themselves.

    An announcement is small and overtakes what it announces. On a quick link the message is there milliseconds later,
    so that a lost one is noticed soon; on a slow one it takes as long as the link needs for it.
    """

    def __init__(self) -> None:
        """Nothing is known yet."""
        self._lateness: float | None = None

    def learn(self, lateness: float) -> None:
        """A message came by itself, this long after its announcement [s]; 0 or less where it came before."""
        late = max(0.0, lateness)
        self._lateness = late if self._lateness is None else max(late, KEPT * self._lateness)

    @property
    def grace(self) -> float:
        """[s] to wait after an announcement."""
        if self._lateness is None:
            return LONGEST
        return min(LONGEST, max(SHORTEST, MARGIN * self._lateness))
