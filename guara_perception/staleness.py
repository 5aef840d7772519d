"""Rejection of questions to stale grids."""

from __future__ import annotations


def refuse_stale(stale_because: tuple[str, ...], allow_stale: bool) -> None:
    """Reject a question to a stale grid, unless the caller allows it.

    Args:
        stale_because: reasons for which the grid is stale; empty for a current one.
        allow_stale: answer from a stale grid too.

    Raises:
        transport.StaleTerrain: it is stale, and that is not allowed.
    """
    if stale_because and not allow_stale:
        # Who only computes grids loads no transport.
        from transport.exceptions import StaleTerrain

        raise StaleTerrain(f"{'; '.join(stale_because)}. Ask a newer grid; allow_stale=True answers from this one")
