"""What the page says about colours, about a grid, and about a point that was clicked."""

from __future__ import annotations

import dataclasses

import numpy as np

import guara_perception as gp
from guara_perception.terrain.drawing.style import HAZARD_COLOURS, UNKNOWN_COLOUR
from guara_perception.terrain.layers.record import ScanRecord
from guara_perception.view.controls import cell_text, legend_html, status_text
from guara_perception.view.terrain_mesh import terrain_mesh


def css(colour: str) -> str:
    return f"rgb({','.join(str(int(colour[i : i + 2], 16)) for i in (1, 3, 5))})"


def test_the_status_says_what_is_seen(grid: gp.TerrainGrid) -> None:
    """Step, mode, extent and attitude; whether it is provisional or withdrawn; reasons of the devices' health."""
    text = status_text(grid)
    assert "**step 7**, standard scan, footprint" in text and "attitude from imu" in text
    assert "provisional" not in text
    data = {**grid.metadata, "provisional": True, "health": {"level": "degraded", "reasons": ["a lamp"]}}
    text = status_text(dataclasses.replace(grid, record=ScanRecord.from_json(data)))
    assert "provisional: not yet confirmed that the robot stood still" in text and "a lamp" in text
    text = status_text(dataclasses.replace(grid, record=ScanRecord.from_json({**data, "withdrawn": True})))
    assert "**withdrawn**" in text and "provisional" not in text


def test_hazards_stand_in_three_groups(grid: gp.TerrainGrid) -> None:
    """Free ground first, then known hazards, then reasons for unknown ground, then what is not drawn at all."""
    hazard = grid.hazard.copy()
    hazard[0, 0] = np.uint16(gp.Hazard.OUT_OF_RANGE)
    hazard[0, 1] = np.uint16(gp.Hazard.DROPOUT)
    elevation = grid.elevation.copy()
    elevation[0, :2] = np.nan
    traversability = grid.traversability.copy()
    traversability[0, :2] = 0
    layers = {**grid.layers, "hazard": hazard, "elevation": elevation, "traversability": traversability}
    html = legend_html(terrain_mesh(dataclasses.replace(grid, layers=layers)))
    known = (
        "a foot may be placed here",
        "Known, not traversable",
        "<b>edge</b>",
        "Unknown, never safe",
        "<b>dropout</b>",
    )
    ranks = [
        html.index(word) for word in (*known, "<b>out of range</b>", "<b>not drawn</b>: unknown because never observed")
    ]
    # Which of the two reasons for unknown ground comes first does not matter.
    assert sorted(ranks[:4]) == ranks[:4] and max(ranks[:4]) < min(ranks[4:6]) < max(ranks[4:6]) < ranks[6]
    assert css(HAZARD_COLOURS[gp.Hazard.DROPOUT]) in html and css(HAZARD_COLOURS[gp.Hazard.EDGE]) in html


def test_scales_have_a_bar_and_say_what_is_unknown(grid: gp.TerrainGrid) -> None:
    """A bar of colours with the values at its ends, the grey of unknown cells, and what is not drawn."""
    html = legend_html(terrain_mesh(grid, "elevation"))
    assert "linear-gradient(to right,rgb(" in html and "+0 mm" in html and "+60 mm" in html
    assert css(UNKNOWN_COLOUR) in html and "<b>unknown</b>: no reliable height" in html
    assert "<b>not drawn</b>: unknown because never observed: never safe" in html
    assert "0 not traversable" in legend_html(terrain_mesh(grid, "traversability"))


def test_a_clicked_point_is_explained_line_by_line(grid: gp.TerrainGrid) -> None:
    """What `explain` says, its verdict in bold: of a known cell, of an unknown one, and outside of the grid."""
    known = cell_text(grid.explain(0.70, 0.10))
    assert known.startswith("**x=0.700 y=0.100**  \n60.0 mm high") and known.splitlines()[-1].startswith(
        "**not traversable"
    )
    unknown = cell_text(grid.explain(0.35, -0.12))
    assert "unknown" in unknown and unknown.endswith("not traversable**")
    assert "**not traversable**" in cell_text(grid.explain(9.0, 0.0))
