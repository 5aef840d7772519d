"""Programs of several parts: `python -m benchmarks PROGRAM PART ...`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping


def run_part(program: str, parts: Mapping[str, Callable[[], None]]) -> None:
    """Run the part that the first argument names, with the arguments after it; exit 2 and list them where none is."""
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if name in parts:
        del sys.argv[1]
        sys.argv[0] = f"benchmarks {program} {name}"
        parts[name]()
        return
    help_is_asked = name in ("-h", "--help")
    lines = [f"  {each:<14} {(run.__doc__ or '').splitlines()[0]}" for each, run in parts.items()]
    print(
        "\n".join([f"usage: benchmarks {program} PART ...; parts:", *lines]), file=None if help_is_asked else sys.stderr
    )
    sys.exit(0 if help_is_asked else 2)
