"""Refusal of questions to grids that a client handed out although something spoke against them."""

from __future__ import annotations


def refuse_stale(stale_because: tuple[str, ...], allow_stale: bool) -> None:
    """Refuse a question to a stale grid, unless the one who asks allows it.

    Args:
        stale_because: what speaks against the grid; empty where nothing does.
        allow_stale: whether the answer is wanted all the same.

    Raises:
        transport.StaleTerrain: it is stale, and that is not allowed.
    """
    if stale_because and not allow_stale:
        # Who only computes grids loads no transport.
        from transport.exceptions import StaleTerrain

        raise StaleTerrain(f"{'; '.join(stale_because)}. Ask a newer grid; allow_stale=True answers from this one")
