"""What colours mean, the status of a grid, and the facts of a cell, as HTML and Markdown for the page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from guara_perception.terrain.drawing.style import UNKNOWN_COLOUR, rgb
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import MEANING, UNKNOWN_MASK, Hazard
from guara_perception.view.scene_drawing import REGION_COLOUR
from guara_perception.view.terrain_mesh import Scale, TerrainMesh

COLOURS_OF_A_BAR = 9
FREE = "a foot may be set here"
REGION = "with its box ticked: any place inside is one for the centre of a sole"
NEVER_LOOKED_AT = "unknown, never looked at: never safe"
UNKNOWN = "looked at, but no height to be trusted: never safe"


def legend_html(mesh: TerrainMesh) -> str:
    """Colours of a mesh and what they mean: hazards in three groups, or a colour bar; and what is not drawn."""
    rows = _scale_rows(mesh.scale) if mesh.scale is not None else _hazard_rows(mesh.legend)
    rows.append(_row("regions", REGION, f"border:2px solid rgb{REGION_COLOUR}".replace(" ", "")))
    rows.append(_row("not drawn", NEVER_LOOKED_AT, "border:1px dashed #888"))
    return f'<div style="font-size:0.75em;line-height:1.5;padding:0 1em">{"".join(rows)}</div>'


def _hazard_rows(legend: Sequence[tuple[str, str]]) -> list[str]:
    groups: dict[str, list[str]] = {"": [], "Known, no foot here": [], "Unknown, never safe": []}
    for name, colour in legend:
        flag = Hazard.NONE if name == "free" else Hazard[name.upper().replace(" ", "_")]
        is_unknown = bool(int(flag) & int(UNKNOWN_MASK))
        group = "" if name == "free" else "Unknown, never safe" if is_unknown else "Known, no foot here"
        groups[group].append(_row(name, FREE if name == "free" else MEANING[flag], f"background:{_css(colour)}"))
    rows = []
    for title, members in groups.items():
        if members:
            rows += [f'<div style="opacity:0.7;margin-top:0.3em">{title}</div>'] if title else []
            rows += members
    return rows


def _scale_rows(scale: Scale) -> list[str]:
    import matplotlib

    colours = matplotlib.colormaps[scale.colours](np.linspace(0, 1, COLOURS_OF_A_BAR))
    stops = ",".join(f"rgb({','.join(str(round(255 * value)) for value in colour[:3])})" for colour in colours)
    ends = f"<span>{scale.low_text}</span><span>{scale.high_text}</span>"
    return [
        f"<div><b>{scale.name}</b></div>",
        f'<div style="height:1em;border-radius:2px;background:linear-gradient(to right,{stops})"></div>',
        f'<div style="display:flex;justify-content:space-between">{ends}</div>',
        _row("unknown", UNKNOWN, f"background:{_css(UNKNOWN_COLOUR)}"),
    ]


def _row(name: str, meaning: str, style: str) -> str:
    box = f'<span style="display:inline-block;flex:none;width:1em;height:1em;margin-top:0.25em;{style}"></span>'
    return f'<div style="display:flex;gap:0.5em">{box}<span><b>{name}</b>: {meaning}</span></div>'


def _css(colour: str) -> str:
    return f"rgb({','.join(str(round(255 * value)) for value in rgb(colour))})"


def status_text(terrain: TerrainGrid) -> str:
    """The status of a grid, in a few lines of Markdown."""
    data = terrain.metadata
    lines = [f"**step {terrain.step}**, {data.get('mode', 'unknown')} scan, {terrain.extent}"]
    known, free = float(np.isfinite(terrain.elevation).mean()), float((terrain.traversability > 0).mean())
    lines.append(f"known {known:.0%}, traversable {free:.0%}")
    if "attitude_source" in data:
        lines.append(f"attitude from {data['attitude_source']}")
    if data.get("withdrawn"):
        lines.append("**withdrawn**")
    elif data.get("provisional"):
        lines.append("provisional: sent before its pause had confirmed it")
    health = data.get("health") or {}
    lines += [str(reason) for reason in health.get("reasons", ())]
    return "  \n".join(lines)


def cell_text(sentence: str) -> str:
    """What `TerrainGrid.explain` says in Markdown: a line for each of its parts, position and verdict in bold."""
    facts, _, verdict = sentence.partition(": ")
    where, _, rest = facts.partition(" is ")
    return f"**{where}**  \n{rest.replace(', ', '  ' + chr(10))}  \n**{verdict}**"
