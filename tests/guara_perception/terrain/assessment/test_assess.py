"""Slope, step, roughness, edges and clearance, compared with values from first principles."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.assessment.assess import DiscTests, assess_layers
from guara_perception.terrain.assessment.disc import clearance
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.layers.geometry import KNOWN_SHARE, disc_kernel
from guara_perception.terrain.layers.hazard import Hazard
from guara_perception.terrain.scan.assess_terrain import default_limits
from tests.thorough import examples

RESOLUTION = 0.005
PROPERTY = settings(max_examples=examples(40), deadline=None, derandomize=True)
SHAPE = (30, 70)


def plane(a: float, b: float, shape: tuple[int, int] = (40, 50)) -> np.ndarray:
    """Heights of z = a x + b y at cell centres."""
    y, x = ((np.mgrid[: shape[0], : shape[1]] + 0.5) * RESOLUTION).astype(np.float64)
    return a * x + b * y


@pytest.mark.slow
@PROPERTY
@given(st.floats(-1, 1), st.floats(-1, 1))
def test_slope_of_a_plane_is_exact(a: float, b: float) -> None:
    """On a plane, every cell with a whole disc has the plane's slope and no roughness."""
    terrain = gp.assess_terrain(plane(a, b), RESOLUTION)
    inner = np.s_[3:-3, 3:-3]
    np.testing.assert_allclose(terrain.slope[inner], np.arctan(np.hypot(a, b)), atol=1e-6)
    assert np.nanmax(terrain.roughness[inner]) < 1e-6


@pytest.mark.slow
@PROPERTY
@given(st.floats(0.1, 1.4), st.integers(0, 3))
def test_slope_does_not_depend_on_the_heading(tangent: float, quarter: int) -> None:
    """A ramp rotated by quarter turns keeps its slope."""
    ramp = np.rot90(plane(tangent, 0.0, (40, 40)), quarter)
    slope = gp.assess_terrain(ramp, RESOLUTION).slope[10:30, 10:30]
    np.testing.assert_allclose(slope, np.arctan(tangent), atol=1e-6)


def test_a_slope_is_as_unsure_as_the_vertical() -> None:
    """A plane of 15 degrees passes the limit of 20 if the vertical is known to 0.1 degrees, and fails at 3."""
    heights = plane(np.tan(np.radians(15.0)), 0.0)
    nothing = np.zeros(heights.shape)
    raster = Raster(heights, nothing, heights, heights)
    limits = dataclasses.replace(default_limits(), step=1.0, drop=1.0)
    steep = {}
    for sigma in (0.1, 3.0):
        layers = assess_layers(
            raster, nothing.astype(np.uint16), RESOLUTION, limits, slope_sigma=float(np.radians(sigma))
        )
        steep[sigma] = ((layers["hazard"] & np.uint16(Hazard.STEEP)) != 0)[5:-5, 5:-5]
    assert not steep[0.1].any() and steep[3.0].all()


def test_what_neighbours_share_is_in_the_total_alone() -> None:
    """Shared variance of any size changes no flag and no score."""
    rng = np.random.default_rng(2)
    heights = plane(0.1, 0.05) + rng.normal(0, 0.001, (40, 50))
    variance = rng.uniform(0, 1e-7, heights.shape)
    raster, none = Raster(heights, variance, heights, heights), np.zeros(heights.shape, np.uint16)
    alone, shared = (
        assess_layers(raster, none, RESOLUTION, default_limits(), shared=each) for each in (0.0, np.ones(none.shape))
    )
    np.testing.assert_allclose(shared["variance"], 1.0 + variance, rtol=1e-6)
    for name in alone:
        if name != "variance":
            np.testing.assert_array_equal(alone[name], shared[name])


def test_roughness_is_the_standard_deviation_about_the_plane() -> None:
    """Noise on a ramp: roughness is the rms distance from a plane fitted to the disc, at right angles to it."""
    rng = np.random.default_rng(1)
    ground = plane(0.3, -0.2) + rng.normal(0, 0.002, (40, 50))
    kernel = disc_kernel(3.0).astype(bool)
    terrain = gp.assess_terrain(ground, RESOLUTION, limits=dataclasses.replace(default_limits(), disc_radius=0.015))
    roughness, slope = terrain.roughness, terrain.slope
    for iy, ix in ((10, 10), (20, 31), (33, 44)):
        window = ground[iy - 3 : iy + 4, ix - 3 : ix + 4]
        dy, dx = (np.mgrid[-3:4, -3:4] * RESOLUTION)[:, kernel]
        design = np.column_stack((dx, dy, np.ones(dx.size)))
        solution, *_ = np.linalg.lstsq(design, window[kernel], rcond=None)
        residual = (window[kernel] - design @ solution) / np.sqrt(1 + solution[0] ** 2 + solution[1] ** 2)
        assert roughness[iy, ix] == pytest.approx(np.sqrt((residual**2).sum() / (dx.size - 1)), rel=1e-7)
        assert slope[iy, ix] == pytest.approx(np.arctan(np.hypot(solution[0], solution[1])), rel=1e-7)


def test_sigma_of_the_slope_is_what_noise_makes_of_it() -> None:
    """Monte Carlo: on a ramp at the limit, as many cells are STEEP as a normal distribution predicts."""
    rng = np.random.default_rng(2)
    sigma, none = 0.001, np.zeros((300, 300), np.uint16)
    ground = plane(0.5, 0.0, none.shape) + rng.normal(0, sigma, none.shape)
    raster = Raster(ground, np.full(ground.shape, sigma**2), ground, ground)
    for sigmas, share in ((0.5, 0.6915), (1.0, 0.8413), (1.5, 0.9332)):
        limits = dataclasses.replace(default_limits(), slope=float(np.arctan(0.5)), confidence=sigmas)
        hazard = assess_layers(raster, none, RESOLUTION, limits)["hazard"][5:-5, 5:-5]
        assert ((hazard & np.uint16(Hazard.STEEP)) != 0).mean() == pytest.approx(share, abs=0.01)


@pytest.mark.slow
@settings(max_examples=examples(12), deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.sampled_from([1.0, 2.9, 3.0, 5.5]))
def test_layers_are_those_of_a_plain_fit_to_each_disc(seed: int, radius: float) -> None:
    """Rough ground with holes: layers of every cell equal a plain computation; columns alone give the same bits."""
    rng = np.random.default_rng(seed)
    shape, limits = (14, 80), dataclasses.replace(default_limits(), disc_radius=radius * RESOLUTION)
    height = plane(rng.normal(0, 0.3), 0.1, shape) + rng.normal(0, rng.choice([1e-4, 2e-3]), shape)
    height[rng.random(shape) < rng.choice([0.0, 0.1, 0.5])] = np.nan
    variance, spread = rng.uniform(0, 1e-6, shape), rng.uniform(0, 0.004, (2, *shape))
    raster = Raster(height, variance, height - spread[0], height + spread[1])
    none = np.zeros(shape, np.uint16)
    layers = assess_layers(raster, none, RESOLUTION, limits, slope_sigma=0.01)
    disc, half = disc_kernel(radius), disc_kernel(radius).shape[0] // 2
    for iy, ix in zip(*np.nonzero(np.isfinite(height)), strict=True):
        y, x = (each[disc > 0] for each in np.mgrid[-half : half + 1, -half : half + 1])
        inside = (iy + y >= 0) & (iy + y < shape[0]) & (ix + x >= 0) & (ix + x < shape[1])
        y, x = y[inside], x[inside]
        known = np.isfinite(height[iy + y, ix + x])
        y, x = y[known], x[known]
        cells = iy + y, ix + x
        rise, fall = raster.high[cells].max() - raster.low[iy, ix], raster.high[iy, ix] - raster.low[cells].min()
        assert layers["step_height"][iy, ix] == pytest.approx(max(rise, fall), rel=1e-6)
        unsure = limits.confidence * np.sqrt(2 * variance[iy, ix])
        expected = Hazard.STEP * (rise + unsure > limits.step) | Hazard.DROP * (fall + unsure > limits.drop)
        expected |= Hazard.UNCERTAIN * (np.sqrt(variance[iy, ix]) > limits.sigma)
        design = np.column_stack((x, y, np.ones(x.size))) * (RESOLUTION, RESOLUTION, 1.0)
        fits = x.size >= KNOWN_SHARE * disc.sum() and all((side < 0).any() and (side > 0).any() for side in (x, y))
        assert np.isfinite(layers["slope"][iy, ix]) == (fits and np.linalg.matrix_rank(design) == 3)
        if np.isfinite(layers["slope"][iy, ix]):
            (a, b, c), *_ = np.linalg.lstsq(design, height[cells], rcond=None)
            steepness, freedom = a * a + b * b, max(x.size - 1, 1)
            residual = ((height[cells] - design @ (a, b, c)) ** 2).sum() / (1 + steepness)
            slope, roughness = np.arctan(np.sqrt(steepness)), np.sqrt(residual / freedom)
            assert layers["slope"][iy, ix] == pytest.approx(slope, abs=1e-6)
            assert layers["roughness"][iy, ix] == pytest.approx(roughness, abs=1e-6)
            mean = variance[cells].mean()
            of_gradient = mean * np.trace(np.linalg.inv(design.T @ design)[:2, :2]) / 2
            slope += limits.confidence * np.hypot(np.sqrt(of_gradient) / (1 + steepness), 0.01)
            expected |= Hazard.STEEP * (slope > limits.slope)
            expected |= Hazard.ROUGH * (roughness + limits.confidence * np.sqrt(mean / 2 / freedom) > limits.roughness)
        assert layers["hazard"][iy, ix] & ~Hazard.EDGE == expected
    part = assess_layers(
        Raster(*(layer[:, 5:75] for layer in raster.layers)), none[:, 5:75], RESOLUTION, limits, slope_sigma=0.01
    )
    for name in ("slope", "step_height", "roughness"):
        assert part[name][:, half:-half].tobytes() == layers[name][:, 5 + half : 75 - half].tobytes()


@pytest.mark.parametrize("changed", [slice(0, 0), slice(0, 2), slice(17, 21), slice(38, 40), slice(0, 40)])
def test_tests_that_are_kept_change_no_bit(changed: slice) -> None:
    """If some columns have changed since the last call, the layers equal those of a first call."""
    rng = np.random.default_rng(5)
    none, discs = np.zeros((60, 40), np.uint16), DiscTests()
    before = plane(0.2, 0.1, none.shape) + rng.normal(0, 1e-3, none.shape)
    after = before.copy()
    after[:, changed] += rng.normal(0, 0.01, after[:, changed].shape)
    after[20:23, changed] = np.nan

    def layers(ground: np.ndarray, kept: DiscTests | None) -> dict[str, np.ndarray]:
        raster = Raster(ground, np.where(np.isnan(ground), np.nan, 1e-7), ground, ground)
        return assess_layers(raster, none, RESOLUTION, default_limits(), discs=kept)

    layers(before, discs)
    kept = layers(after, discs)
    for name, layer in layers(after, None).items():
        assert layer.tobytes() == kept[name].tobytes(), name


def test_a_step_is_measured_to_the_height_of_the_box() -> None:
    """Beside and on a box, the step height is that of the box, within the disc's reach and nowhere else."""
    ground = np.zeros((40, 40))
    ground[:, 20:] = 0.045
    terrain = gp.assess_terrain(ground, RESOLUTION)
    np.testing.assert_allclose(terrain.step_height[5:-5, 17:23], 0.045, atol=1e-7)
    np.testing.assert_allclose(terrain.step_height[5:-5, :17], 0.0, atol=1e-7)
    np.testing.assert_allclose(terrain.step_height[5:-5, 23:], 0.0, atol=1e-7)


def test_up_and_down_are_distinguished() -> None:
    """Below a box of 45 mm is a step, on it a drop; a fall of 25 mm is too deep, a rise of 25 mm is not."""
    ground = np.zeros((40, 40))
    ground[:, 20:] = 0.045
    high = gp.assess_terrain(ground, RESOLUTION)
    assert (high.hazard[20, 17:20] & Hazard.STEP).all()
    assert not (high.hazard[20, 17:20] & Hazard.DROP).any()
    assert (high.hazard[20, 20:23] & Hazard.DROP).all()
    assert not (high.hazard[20, 20:23] & Hazard.STEP).any()
    ground[:, 20:] = 0.025
    low = gp.assess_terrain(ground, RESOLUTION)
    assert not (low.hazard & Hazard.STEP).any()
    assert (low.hazard[20, 20:23] & Hazard.DROP).all()


def test_a_step_inside_one_cell_counts() -> None:
    """Samples of one cell that are 35 mm apart make a step, although the mean heights are flat."""
    flat, high = np.zeros((40, 40)), np.zeros((40, 40))
    high[20, 20] = 0.035
    layers = assess_layers(Raster(flat, flat, flat, high), flat.astype(np.uint16), RESOLUTION, default_limits())
    assert layers["hazard"][20, 20] & Hazard.STEP
    assert layers["step_height"][20, 20] == np.float32(0.035)


@pytest.mark.parametrize(
    ("limit", "flag"),
    [("slope", Hazard.STEEP), ("step", Hazard.STEP), ("drop", Hazard.DROP), ("roughness", Hazard.ROUGH)],
)
def test_the_upper_confidence_bound_is_tested(limits: TraversabilityLimits, limit: str, flag: Hazard) -> None:
    """Ground just below a limit is safe if known exactly, and a hazard if its height is uncertain."""
    y, x = np.mgrid[:40, :40] * RESOLUTION
    ground = {
        "slope": x * np.tan(0.95 * limits.slope),
        "step": np.where(x > 0.1, 0.95 * limits.step, 0.0),
        "drop": np.where(x > 0.1, 0.95 * limits.drop, 0.0),
        "roughness": 0.0030 * np.where((np.arange(40)[:, None] + np.arange(40)) % 2, 1.0, -1.0),
    }[limit]
    loose = {name: 10.0 if name != "slope" else 1.5 for name in ("slope", "step", "drop", "roughness")}
    loose = {name: min(value, 1.0) if name != "slope" else value for name, value in loose.items() if name != limit}
    only = dataclasses.replace(limits, **loose)
    exact = gp.assess_terrain(ground, RESOLUTION, limits=only)
    unsure = gp.assess_terrain(ground, RESOLUTION, variance=np.full(ground.shape, 0.003**2), limits=only)
    assert not (exact.hazard & flag).any()
    assert (unsure.hazard & flag).any()


def test_a_height_that_is_too_unsure_is_uncertain(limits: TraversabilityLimits) -> None:
    """UNCERTAIN is set exactly where the standard deviation exceeds its limit."""
    variance = np.full((40, 40), (0.99 * limits.sigma) ** 2)
    variance[20, 20] = (1.01 * limits.sigma) ** 2
    terrain = gp.assess_terrain(np.zeros((40, 40)), RESOLUTION, variance=variance)
    assert np.argwhere(terrain.hazard & Hazard.UNCERTAIN).tolist() == [[20, 20]]


def test_score_falls_with_every_test_and_is_one_on_perfect_ground() -> None:
    """Flat, exactly known ground scores 1; half the limit of slope scores half; scores are multiplied."""
    flat = gp.assess_terrain(np.zeros((60, 60)), RESOLUTION)
    assert flat.traversability[30, 30] == 1.0
    limit = 0.35
    ramp = gp.assess_terrain(plane(np.tan(limit / 2), 0.0, (60, 60)), RESOLUTION)
    rise = 3 * RESOLUTION * np.tan(limit / 2)
    expected = 0.5 * (1 - rise / 0.030) * (1 - rise / 0.020)
    assert ramp.traversability[30, 30] == pytest.approx(expected, rel=1e-5)


def test_deeper_than_60_mm_everything_empty_is_traversable(scan_grid: gp.TerrainGrid) -> None:
    """On known, flat ground exactly the cells with centres within 60 mm of the front or rear are EDGE."""
    ny, nx = scan_grid.shape
    terrain = gp.assess_terrain(np.zeros((ny, nx)), RESOLUTION)
    depth_x = (np.minimum(np.arange(nx), nx - 1 - np.arange(nx)) + 0.5) * RESOLUTION
    depth_y = (np.minimum(np.arange(ny), ny - 1 - np.arange(ny)) + 0.5) * RESOLUTION
    deep = (depth_y[:, None] > 0.060) & (depth_x[None, :] > 0.060)
    assert (terrain.hazard[deep] == 0).all()
    # A margin of half a sole (40 mm) along the border is never free.
    assert (terrain.hazard[:, depth_x < 0.040] == Hazard.EDGE).all()
    assert (terrain.hazard[depth_y < 0.030] == Hazard.EDGE).all()


def test_the_sole_must_fit(limits: TraversabilityLimits) -> None:
    """EDGE cells are exactly those from which the 80 x 60 mm sole or a test would reach an unknown cell."""
    ground = np.zeros((80, 80))
    ground[40, 40] = np.nan
    terrain = gp.assess_terrain(ground, RESOLUTION)
    edge = (terrain.hazard[13:-13, 13:-13] & Hazard.EDGE) != 0
    offsets = np.argwhere(edge) + 13 - 40
    assert np.abs(offsets[:, 1]).max() * RESOLUTION == pytest.approx(0.060)
    assert np.abs(offsets[:, 0]).max() * RESOLUTION == pytest.approx(0.050)
    for dy, dx in ((0, 8), (6, 0), (6, 8)):
        assert terrain.hazard[40 + dy, 40 + dx] & Hazard.EDGE


def test_clearance_is_the_distance_to_the_nearest_hazard_or_the_border() -> None:
    """From the cell's centre to the nearest point of the unknown cell; negative inside; to a nearer border."""
    ground = np.zeros((40, 60))
    ground[20, 30] = np.nan
    terrain = gp.assess_terrain(ground, RESOLUTION)
    assert terrain.clearance[20, 35] == pytest.approx(4.5 * RESOLUTION)
    assert terrain.clearance[23, 34] == pytest.approx(np.hypot(2.5, 3.5) * RESOLUTION)
    assert terrain.clearance[20, 30] == pytest.approx(-0.5 * RESOLUTION)
    assert terrain.clearance[0, 5] == pytest.approx(0.5 * RESOLUTION)
    assert terrain.clearance[10, 2] == pytest.approx(2.5 * RESOLUTION)


@pytest.mark.parametrize("share", [0.001, 0.02, 0.5, 0.98])
def test_clearance_equals_a_search_over_all_cells(share: float) -> None:
    """The distance from a centre to squares, not to centres less half a cell, which overstates it on diagonals."""
    rng = np.random.default_rng(7)
    is_hazard = rng.random((23, 37)) < share
    flags = np.where(is_hazard, np.uint16(Hazard.UNSCANNED), np.uint16(Hazard.EDGE))
    found = clearance(flags, RESOLUTION)
    for iy, ix in np.ndindex(flags.shape):
        others = np.argwhere(is_hazard != is_hazard[iy, ix])
        apart = np.maximum(np.abs(others - (iy, ix)) - 0.5, 0.0)
        border = min(iy, 22 - iy, ix, 36 - ix) + 0.5
        nearest = np.hypot(*apart.T).min(initial=np.inf)
        wanted = -min(nearest, border if np.isinf(nearest) else np.inf) if is_hazard[iy, ix] else min(nearest, border)
        assert found[iy, ix] == pytest.approx(wanted * RESOLUTION, rel=1e-6)


def test_clearance_where_all_is_hazard_is_never_positive() -> None:
    """An unknown grid has no positive clearance."""
    terrain = gp.assess_terrain(np.full((10, 12), np.nan), RESOLUTION)
    assert (terrain.clearance < 0).all()


def test_values_need_most_of_the_disc_on_all_sides() -> None:
    """With 60 % of the disc known there is a slope; beside a wide gap it is NaN, and the cell is EDGE."""
    ground = plane(0.1, 0.0)
    ground[:, 20:] = np.nan
    terrain = gp.assess_terrain(ground, RESOLUTION)
    assert np.isnan(terrain.slope[20, 19])
    assert np.isfinite(terrain.slope[20, 17])
    assert terrain.slope[20, 17] == pytest.approx(np.arctan(0.1), abs=1e-6)
    assert (terrain.hazard[20, 17:20] & Hazard.EDGE).all()


def test_too_fine_a_grid_for_the_disc_is_refused() -> None:
    """A disc of too many cells is rejected, with advice."""
    with pytest.raises(gp.InvalidInput, match="150 cells, allowed: at most 24; use larger cells"):
        gp.assess_terrain(np.zeros((10, 10)), 0.0001)
