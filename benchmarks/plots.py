"""Picture of the error against the time of every extraction."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from benchmarks.section import Section
from guara_perception.terrain.drawing.style import LINE_COLOURS, new_figure, save_figure

MARKERS = "osD^vPX"


def error_against_time(section: Section, path: Path) -> None:
    """Mean error over time, one panel per kind of light; down and left is better."""
    cases: Mapping[str, Mapping[str, Mapping[str, float]]] = section.figures
    from matplotlib.ticker import NullLocator

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
    for panel in axes[0]:
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_minor_locator(NullLocator())
            axis.set_major_formatter("{x:g}")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    save_figure(figure, path)
