"""The transport: slow viewers, floods of announcements, fleets of robots, and encodings of a grid.

`python -m benchmarks transport PART ...`; without a part: a list of them.
"""

from __future__ import annotations

from benchmarks import announcements, compact, fleet, viewers
from benchmarks.command import run_part


def main() -> None:
    """Command line."""
    parts = {"viewers": viewers.main, "announcements": announcements.main, "fleet": fleet.main}
    run_part("transport", {**parts, "compact": compact.main})


if __name__ == "__main__":
    main()
