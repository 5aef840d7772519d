"""Two pictures: error against time of every extraction, and growth with stripes, pixels and cells."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.section import Section
from guara_perception.terrain.drawing.style import LINE_COLOURS, new_figure, save_figure

MARKERS = "osD^vPX"


def error_against_time(section: Section, path: Path) -> None:
    """Mean error over time, one panel per kind of light; down and left is better."""
    cases: Mapping[str, Mapping[str, Mapping[str, float]]] = section.figures
    figure, axes = new_figure(1, len(cases), (9.0, 3.6), sharex=True, sharey=True)
    for panel, (case, contenders) in zip(axes[0], cases.items(), strict=True):
        for i, (name, f) in enumerate(contenders.items()):
            colour = LINE_COLOURS[i % len(LINE_COLOURS)]
            panel.plot(f["ratio"], f["mean"], MARKERS[i % len(MARKERS)], color=colour, label=name, markersize=6)
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_title(case)
        panel.set_xlabel("time, x reference")
        panel.grid(True, which="major", linewidth=0.3)
    axes[0][0].set_ylabel("mean error [px]")
    _plain_ticks(axes)
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    save_figure(figure, path)


def growth_plot(section: Section, path: Path) -> None:
    """CPU time over size, with the fitted power law."""
    figure, axes = new_figure(1, len(section.figures), (9.0, 2.8))
    for panel, (name, f) in zip(axes[0], section.figures.items(), strict=True):
        sizes, times = np.array(f["sizes"], float), np.array(f["milliseconds"])
        slope, offset = np.polyfit(np.log(sizes), np.log(times), 1)
        panel.plot(sizes, times, "o", color=LINE_COLOURS[0], markersize=5, label="measured")
        panel.plot(sizes, np.exp(offset) * sizes**slope, "-", color=LINE_COLOURS[1], label=f"size$^{{{slope:.2f}}}$")
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_xlabel(f"number of {name}")
        panel.grid(True, which="major", linewidth=0.3)
        panel.legend(loc="upper left")
    axes[0][0].set_ylabel("CPU time [ms]")
    _plain_ticks(axes)
    save_figure(figure, path)


def _plain_ticks(axes: npt.NDArray[Any]) -> None:
    """Ticks at 1, 2 and 5 of each decade where there is room, with k and M for thousands and millions."""
    from matplotlib.ticker import EngFormatter, LogLocator, NullLocator

    for panel in axes.ravel():
        for axis, (low, high) in ((panel.xaxis, panel.get_xlim()), (panel.yaxis, panel.get_ylim())):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 100 * low else (1.0,), numticks=12))
            axis.set_minor_locator(NullLocator())
            axis.set_major_formatter(EngFormatter() if low > 1 else "{x:g}")
