"""What stands in the way of the targets that are not met, for the documents; only the missed ones are printed."""

from __future__ import annotations

from benchmarks.section import Section

REASONS: dict[str, str] = {}


def remarks(targets: Section) -> str:
    """A paragraph per missed target."""
    missed = [name for name, figure in targets.figures.items() if not figure["met"]]
    lines = [f"- *{name}*: {REASONS.get(name, 'see the profile below')}." for name in missed]
    return "\n".join(["### What stands in the way", "", *lines, ""]) if lines else ""
