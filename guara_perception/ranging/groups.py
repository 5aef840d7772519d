"""Stripes in groups: worked on together they share the fixed cost of numpy's calls."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

Item = TypeVar("Item")

# With more of them their arrays no longer stay in the processor's cache.
TOGETHER = 8


def in_groups(items: list[Item], size: int = TOGETHER) -> Iterator[list[Item]]:
    """The items in their order, TOGETHER at a time; the last group may have fewer."""
    return (items[begin : begin + size] for begin in range(0, len(items), size))
