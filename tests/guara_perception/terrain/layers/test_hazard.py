"""Safety invariant: lost observations never make ground safe, and no unsafe grid can be created."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import guara_perception as gp
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard, check_invariant
from guara_perception.terrain.questions.reason import Reason
from tests.thorough import examples

# A disc of three cells and a sole of two by one cells, so that windows fit small grids.
LIMITS = TraversabilityLimits(
    slope=0.35,
    step=0.030,
    drop=0.020,
    roughness=0.0035,
    sigma=0.005,
    disc_radius=0.010,
    confidence=2.0,
    sole_length=0.025,
    sole_width=0.015,
)
RESOLUTION = 0.005
PROPERTY = settings(max_examples=examples(60), deadline=None, derandomize=True)


def heights(seed: int, shape: tuple[int, int], roughness: float, step: float) -> np.ndarray:
    """Random ground: a tilted plane with noise and a box, or a trench if `step` is negative."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]] * RESOLUTION
    ground = rng.uniform(-0.3, 0.3) * x + rng.uniform(-0.3, 0.3) * y + rng.normal(0, roughness, shape)
    iy, ix = (int(rng.integers(0, n)) for n in shape)
    ground[iy : iy + 6, ix : ix + 8] += step
    return ground


@st.composite
def grids(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Elevation and variance of ground that is partly safe and partly unsafe."""
    shape = (draw(st.integers(15, 34)), draw(st.integers(15, 34)))
    elevation = heights(
        draw(st.integers(0, 10_000)),
        shape,
        draw(st.sampled_from([0.0, 1e-4, 1e-3])),
        draw(st.sampled_from([0.0, 0.005, 0.02, -0.018, 0.05])),
    )
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    return elevation, rng.uniform(0, draw(st.sampled_from([1e-9, 1e-6, 3e-5])), shape)


@st.composite
def holes(draw: st.DrawFn, shape: tuple[int, int]) -> np.ndarray:
    """Any set of cells: single ones, rectangles, whole rows or columns, or all."""
    kind = draw(st.sampled_from(["cells", "rectangle", "rows", "columns", "all"]))
    mask = np.zeros(shape, dtype=bool)
    if kind == "cells":
        return draw(hnp.arrays(bool, shape, elements=st.booleans(), fill=st.just(False)))
    iy, ix = draw(st.integers(0, shape[0] - 1)), draw(st.integers(0, shape[1] - 1))
    height, width = draw(st.integers(1, 8)), draw(st.integers(1, 8))
    if kind == "rectangle":
        mask[iy : iy + height, ix : ix + width] = True
    elif kind == "rows":
        mask[iy : iy + height] = True
    elif kind == "columns":
        mask[:, ix : ix + width] = True
    else:
        mask[:] = True
    return mask


@PROPERTY
@given(grids())
def test_the_rules_of_one_grid_hold_together(grid: tuple[np.ndarray, np.ndarray]) -> None:
    """NaN <=> unknown flag; no hazard <=> score above 0 <=> is_traversable <=> occupancy below 100."""
    elevation, variance = grid
    elevation[3:5, 4:9] = np.nan
    terrain = gp.assess_terrain(elevation, RESOLUTION, variance=variance, limits=LIMITS)
    unknown = (terrain.hazard & UNKNOWN_MASK) != 0
    safe = terrain.hazard == 0
    x, y = (layer.ravel() for layer in np.meshgrid(*terrain.geometry.centres()))
    np.testing.assert_array_equal(np.isnan(terrain.elevation), unknown)
    np.testing.assert_array_equal(np.isnan(elevation), unknown)
    np.testing.assert_array_equal(terrain.traversability > 0, safe)
    np.testing.assert_array_equal(terrain.is_traversable(x, y).reshape(safe.shape), safe)
    np.testing.assert_array_equal(terrain.to_occupancy() < 100, safe)
    np.testing.assert_array_equal(terrain.to_occupancy(unknown=-1) == -1, unknown)


@PROPERTY
@given(st.data(), grids())
def test_losing_cells_never_makes_another_cell_safe(data: st.DataObject, grid: tuple[np.ndarray, np.ndarray]) -> None:
    """After any set of cells is lost, no cell is safe that was not safe before."""
    elevation, variance = grid
    before = gp.assess_terrain(elevation, RESOLUTION, variance=variance, limits=LIMITS)
    lost = data.draw(holes(elevation.shape))
    after = gp.assess_terrain(np.where(lost, np.nan, elevation), RESOLUTION, variance=variance, limits=LIMITS)
    assert not ((after.hazard == 0) & (before.hazard != 0)).any()
    assert not after.is_traversable(*cell_centres(after, lost)).any()


def test_the_property_is_not_empty() -> None:
    """Random grids contain safe and unsafe cells, and some holes leave safe cells, so the property is tested."""
    safe = unsafe = kept = 0
    for seed in range(20):
        elevation = heights(seed, (30, 30), 1e-4, 0.05)
        before = gp.assess_terrain(elevation, RESOLUTION, limits=LIMITS)
        elevation[2:4, 2:4] = np.nan
        after = gp.assess_terrain(elevation, RESOLUTION, limits=LIMITS)
        safe += int((before.hazard == 0).sum())
        unsafe += int((before.hazard != 0).sum())
        kept += int((after.hazard == 0).sum())
    assert safe > 1000
    assert unsafe > 1000
    assert kept > 500


@pytest.mark.parametrize("radius", [0.005, 0.015, 0.030])
def test_losing_cells_far_away_changes_no_bit(radius: float) -> None:
    """Slope, roughness and score of a cell are bit-identical for any change outside its window."""
    rng = np.random.default_rng(3)
    limits = dataclasses.replace(LIMITS, disc_radius=radius)
    elevation = 0.2 + rng.normal(0, 1e-3, (60, 60))
    before = gp.assess_terrain(elevation, RESOLUTION, limits=limits)
    elevation[:5] = np.nan
    elevation[:, 55:] = 0.4
    after = gp.assess_terrain(elevation, RESOLUTION, limits=limits)
    for name in ("slope", "roughness", "step_height", "traversability"):
        np.testing.assert_array_equal(before.layer(name)[30:, :30], after.layer(name)[30:, :30])


def test_unknown_ground_is_not_safe_however_large_the_cells_are() -> None:
    """With cells larger than sole and disc, slopes are tested, and neighbours of unknown cells are EDGE."""
    elevation = np.tile(np.arange(9) * 0.05, (9, 1))
    steep = gp.assess_terrain(elevation, 0.05, limits=dataclasses.replace(LIMITS, step=1.0, drop=1.0, roughness=1.0))
    assert (steep.hazard[2:-2, 2:-2] & Hazard.STEEP).all()
    elevation[:] = 0.0
    elevation[4, 4] = np.nan
    holed = gp.assess_terrain(elevation, 0.05, limits=LIMITS)
    assert holed.hazard[4, 6] & Hazard.EDGE


@pytest.mark.parametrize(
    ("layer", "value", "message"),
    [
        ("elevation", np.nan, "NaN without an unknown flag"),
        ("elevation", np.inf, "elevation is infinite"),
        ("variance", np.nan, "variance of a known cell"),
        ("variance", -1.0, "variance of a known cell"),
        ("variance", np.inf, "variance of a known cell"),
        ("elevation_max", np.nan, "elevation_max of a known cell do not ascend"),
        ("elevation_max", np.inf, "elevation_max of a known cell do not ascend"),
        ("elevation_max", -0.001, "elevation_max of a known cell do not ascend"),
        ("elevation_min", np.nan, "elevation_max of a known cell do not ascend"),
        ("elevation_min", 0.001, "elevation_max of a known cell do not ascend"),
        ("traversability", 0.0, "traversable with a hazard, or not traversable without one"),
        ("traversability", 1.5, "outside 0 ... 1"),
        ("traversability", np.nan, "outside 0 ... 1"),
        ("hazard", Hazard.STEP, "traversable with a hazard, or not traversable without one"),
        ("hazard", Hazard.DROPOUT, "NaN without an unknown flag"),
    ],
)
def test_a_broken_rule_is_refused_with_its_cell(layer: str, value: float, message: str) -> None:
    """One wrong value is rejected; the message names the rule, the number of cells and the first of them."""
    layers = {name: np.array(array) for name, array in flat().layers.items()}
    layers[layer][20, 25] = value
    with pytest.raises(gp.UnsafeGrid, match=message) as caught:
        check_invariant(layers)
    assert "1 cells, the first at iy=20, ix=25" in str(caught.value)


def test_a_safe_cell_beside_an_unknown_one_is_refused() -> None:
    """A grid without its EDGE flags around a hole is rejected."""
    elevation = np.zeros((40, 40))
    elevation[20, 20] = np.nan
    layers = {n: np.array(a) for n, a in gp.assess_terrain(elevation, RESOLUTION, limits=LIMITS).layers.items()}
    edge = layers["hazard"][19, 20] == Hazard.EDGE
    assert edge
    layers["hazard"][19, 20] = 0
    layers["traversability"][19, 20] = 1
    with pytest.raises(gp.UnsafeGrid, match="beside an unknown one"):
        check_invariant(layers)


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("slope", None, "layer slope is missing"),
        ("slope", np.zeros((3, 3), np.float32), r"layer slope is float32 \(3, 3\)"),
        ("hazard", np.zeros((40, 40), np.uint8), r"layer hazard is uint8"),
    ],
)
def test_missing_or_wrong_layers_are_refused(name: str, array: np.ndarray | None, message: str) -> None:
    """Every layer must be present, with its type and shape."""
    layers = dict(flat().layers)
    if array is None:
        del layers[name]
    else:
        layers[name] = array
    with pytest.raises(gp.UnsafeGrid, match=message):
        check_invariant(layers)


def flat() -> gp.TerrainGrid:
    """Flat grid with safe cells at its centre."""
    return gp.assess_terrain(np.zeros((40, 40)), RESOLUTION, limits=LIMITS)


def cell_centres(terrain: gp.TerrainGrid, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates x and y of the centres of the marked cells."""
    x, y = terrain.geometry.centres()
    iy, ix = np.nonzero(mask)
    return x[ix], y[iy]


@pytest.mark.parametrize(
    ("reason", "expected_text"),
    [
        (Reason("step", 0.0125, 0.01, "m"), "step 12.5 mm, allowed 10 mm"),
        (Reason("slope", 0.6, 0.54, "rad", "to the left"), "slope 34.4 deg, allowed 30.9 deg (to the left)"),
        (Reason("reach", float("nan"), 0.0, "rad", "of lf beyond"), "reach impossible (of lf beyond)"),
        (Reason("reach", float("nan"), 0.0, "rad"), "reach impossible"),
        (Reason("unknown", 0.0136, 0.0, "share", "of the sole: X"), "unknown 1.36 %, allowed 0 % (of the sole: X)"),
    ],
)
def test_text(reason: Reason, expected_text: str):
    """A missing value is not printed as nan."""
    assert str(reason) == expected_text
