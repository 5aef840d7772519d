"""Whole scans in many kinds of light: no cell that is dark, unseen or made up is ever called traversable."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.simulation import EFFECTS, real_light
from guara_perception.terrain.layers.record import ScanRecord
from testbed.grid_truth import figures, made_up
from testbed.scenes import ScanInMemory, simulated

EVERY_LIGHT = {
    **{name: {name: 1.0} for name in EFFECTS},
    **{f"all at {strength:g}": dict.fromkeys(EFFECTS, strength) for strength in (0.15, 0.3, 0.6, 1.0)},
    "clipped, with a halo and ghosts": {"clipping": 1.0, "halo": 1.0, "ghosts": 1.0},
    "weak on a bright board": {"weak_line": 1.0, "chessboard": 1.0, "ambient": 0.5},
    "weak, with noise and JPEG": {"weak_line": 1.0, "noise": 1.0, "jpeg": 1.0, "demosaicing": 1.0},
    "drift on a board": {"drift": 0.5, "flicker": 1.0, "chessboard": 1.0},
}


@functools.lru_cache(maxsize=1)
def rendered(light: str) -> ScanInMemory:
    """The benchmark's scene in one light."""
    return simulated((640, 512), 35, real_light(EVERY_LIGHT[light]), seed=5)


@pytest.mark.heavy
@pytest.mark.parametrize("light", EVERY_LIGHT)
def test_no_light_makes_a_cell_traversable_that_is_dark_unseen_or_made_up(light: str) -> None:
    """With a laser-off picture for each stripe, for every third one and for none; judged by the rendered scene."""
    scan = rendered(light)
    assert scan.truth is not None
    for every in (1, 3, len(scan.frames) + 1):
        processor = scan.processor()
        for number, (index, on, off) in enumerate(scan.frames, start=1):
            processor.add(index, on, off if number % every == 0 else None)
        terrain = processor.finish()
        assert figures(terrain, scan.truth).unsafe == 0, f"a laser-off picture for every {every}."
        assert made_up(terrain, scan.truth) == 0, f"a laser-off picture for every {every}."


@pytest.mark.slow
def test_a_height_that_is_not_there_would_be_counted() -> None:
    """`made_up` finds the one cell of a good grid that was lifted by a centimetre."""
    scan = simulated((320, 256), 35, is_uncertain=False)
    assert scan.truth is not None
    processor = scan.processor()
    scan.add_to(processor)
    terrain = processor.finish()
    assert made_up(terrain, scan.truth) == 0
    layers = {name: np.array(terrain.layer(name)) for name in terrain.layers}
    iy, ix = np.argwhere(np.asarray(terrain.traversability) > 0)[0]
    for name in ("elevation_min", "elevation", "elevation_max"):
        layers[name][iy, ix] += 0.01
    spoiled = gp.TerrainGrid(
        layers=layers, geometry=terrain.geometry, record=ScanRecord.from_json(dict(terrain.metadata))
    )
    assert made_up(spoiled, scan.truth) == 1
