"""How long a message that was announced is waited for before it is asked for."""

from __future__ import annotations

# [s] At most, as where nothing is known of the link yet, and at least: a machine that is busy for a moment is no loss.
LONGEST, SHORTEST = 0.3, 0.02
# Times the latest lateness before it, after which a message is taken as lost.
MARGIN = 4.0
# Of the latest before, what is still believed after each message.
KEPT = 0.9


class Patience:
    """Learns how late messages come that come by themselves.

    An announcement is small and overtakes what it announces. On a quick link the message is there milliseconds later,
    so that a lost one is noticed soon; on a slow one it takes as long as the link needs for it.
    """

    def __init__(self) -> None:
        """Nothing is known yet."""
        self._latest: float | None = None

    def learn(self, lateness: float) -> None:
        """A message came by itself, this long after its announcement [s]; 0 or less where it came before."""
        late = max(0.0, lateness)
        self._latest = late if self._latest is None else max(late, KEPT * self._latest)

    @property
    def grace(self) -> float:
        """[s] to wait after an announcement."""
        if self._latest is None:
            return LONGEST
        return min(LONGEST, max(SHORTEST, MARGIN * self._latest))
