"""Where this project's own time goes: the functions of a scan that take most of it, under Python's profiler."""

from __future__ import annotations

import cProfile
import pstats
from pathlib import Path

from benchmarks import whole_scan
from benchmarks.section import Section
from testbed.scenes import ROBOTS, ScanInMemory

SHOWN = 16


def hotspots(scan: ScanInMemory) -> Section:
    """Share of a scan's time in each of this project's functions, callees included."""
    whole_scan.process(scan, "precise")
    profiler = cProfile.Profile()
    profiler.runcall(whole_scan.process, scan, "precise")
    stats = pstats.Stats(profiler).stats  # type: ignore[attr-defined]
    total = max(cumulative for _, _, _, cumulative, _ in stats.values())
    root = str(ROBOTS.parent / "guara_perception")
    own = [
        (cumulative / total, calls, Path(file).relative_to(ROBOTS.parent).as_posix(), function)
        for (file, _, function), (_, calls, _, cumulative, _) in stats.items()
        if file.startswith(root) and not function.startswith("<")
    ]
    own.sort(reverse=True)
    rows: list[tuple[str, ...]] = [
        (f"`{function}`", f"`{file}`", str(calls), f"{share:.0%}") for share, calls, file, function in own[:SHOWN]
    ]
    return Section(
        "hotspots",
        f"Profile of a scan ({scan.name})",
        "Share of one whole scan spent in each function and what it calls, under cProfile, which makes small functions "
        "look more expensive than they are.",
        ("function", "file", "calls", "share"),
        rows,
        {f"{file}:{function}": share for share, _, file, function in own[:SHOWN]},
    )
