"""One-line summary of a grid."""

import dataclasses

import numpy as np

import guara_perception as gp
from guara_perception.app.summary import summary
from guara_perception.terrain.layers.record import ScanRecord


def test_values_are_those_of_the_grid(paper_terrain: gp.TerrainGrid):
    """Known and traversable fractions, source of the attitude, and the most frequent flags in order."""
    line = summary(paper_terrain)
    known = np.isfinite(paper_terrain.elevation).mean()
    safe = (paper_terrain.traversability > 0).mean()
    assert f"known {known:.0%}, traversable {safe:.0%}, attitude from imu" in line
    flags = line.split("hazards ")[1].split(",")[0].split()
    names, counts = flags[::2], [int(count) for count in flags[1::2]]
    assert len(names) == 4 and counts == sorted(counts, reverse=True)
    for name, count in zip(names, counts, strict=True):
        assert count == int(((np.asarray(paper_terrain.hazard) & gp.Hazard[name]) != 0).sum())
    assert "\n" not in line


def test_what_is_wrong_stands_at_the_end(paper_terrain: gp.TerrainGrid):
    """Reasons of a degraded scan."""
    metadata = {**paper_terrain.metadata, "health": {"level": "degraded", "reasons": ["stripe 4: blank", "x"]}}
    assert summary(dataclasses.replace(paper_terrain, record=ScanRecord.from_json(metadata))).endswith(
        ", stripe 4: blank; x"
    )


def test_grid_without_a_report_has_a_line_too():
    """Terrain assessed from heights alone has `?` for unknown fields."""
    line = summary(gp.assess_terrain(np.zeros((4, 6), np.float32), 0.02))
    assert line.startswith("step 0, ?, 6x4 cells of 20 mm, known 100%, traversable 0%, attitude from ?")
