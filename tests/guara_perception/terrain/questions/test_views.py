"""Normals, coarser grids, explanations and obstacles."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from guara_perception.terrain.questions.obstacles import fit_floor
from tests.thorough import examples

PROPERTY = settings(max_examples=examples(30), deadline=None, derandomize=True)


@pytest.mark.slow
@PROPERTY
@given(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8))
def test_normals_of_a_plane(a: float, b: float) -> None:
    """z = a x + b y has the normal (-a, -b, 1), everywhere, for numbers and arrays."""
    y, x = (np.mgrid[:40, :40] + 0.5) * 0.005
    terrain = gp.assess_terrain(a * x + b * y, 0.005)
    expected = np.array([-a, -b, 1.0]) / np.sqrt(1 + a * a + b * b)
    np.testing.assert_allclose(terrain.normal_at(0.1, 0.1), expected, atol=1e-5)
    np.testing.assert_allclose(terrain.normal_at([[0.05, 0.1]], [[0.1, 0.15]]), [[expected] * 2], atol=1e-5)


def test_a_normal_is_given_where_a_slope_is() -> None:
    """Beside a gap, in it, at the border and outside, the normal is NaN exactly where the slope is."""
    heights = np.zeros((40, 40))
    heights[:, 20:24] = np.nan
    terrain = gp.assess_terrain(heights, 0.005)
    x, y = np.meshgrid(*terrain.geometry.centres())
    np.testing.assert_array_equal(np.isfinite(terrain.normal_at(x, y)).all(axis=-1), np.isfinite(terrain.slope))


@pytest.mark.slow
@PROPERTY
@given(st.integers(0, 500), st.sampled_from([1, 2, 3, 4, 6, 12]))
def test_coarser_cells_are_as_bad_as_their_worst_fine_cell(seed: int, factor: int) -> None:
    """Unknown if any is unknown, safe only if all are safe, with a valid invariant."""
    rng = np.random.default_rng(seed)
    heights = np.where(rng.random((120, 96)) < 0.001, np.nan, rng.normal(0, 0.0005, (120, 96)))
    heights[40:60, 10:40] += rng.choice([0.0, 0.05])
    fine = gp.assess_terrain(heights, 0.005, origin=(0.1, -0.2))
    coarse = fine.coarser(factor)
    assert coarse.resolution == pytest.approx(0.005 * factor)
    assert coarse.origin == fine.origin
    unknown = (fine.hazard & UNKNOWN_MASK) != 0
    ny, nx = coarse.shape

    def blocks(layer: np.ndarray) -> np.ndarray:
        """Fine cells (ny, nx, factor * factor) of each coarse cell."""
        return layer.reshape(ny, factor, nx, factor).swapaxes(1, 2).reshape(ny, nx, -1)

    is_unknown = blocks(unknown).any(axis=-1)
    np.testing.assert_array_equal((coarse.hazard & UNKNOWN_MASK) != 0, is_unknown)
    flags = np.bitwise_or.reduce(blocks(fine.hazard), axis=-1)
    np.testing.assert_array_equal(coarse.hazard | np.uint16(Hazard.EDGE), flags | np.uint16(Hazard.EDGE))
    is_safe = coarse.traversability > 0
    assert (blocks(fine.hazard)[is_safe] == 0).all()
    worst = blocks(fine.traversability).min(axis=-1)
    np.testing.assert_array_equal(coarse.traversability[is_safe], worst[is_safe])
    for name, of_block in (
        ("elevation_max", np.max),
        ("elevation_min", np.min),
        ("variance", np.max),
        ("clearance", np.min),
    ):
        expected = of_block(blocks(getattr(fine, name)), axis=-1)
        np.testing.assert_array_equal(getattr(coarse, name)[~is_unknown], expected[~is_unknown])


@pytest.mark.parametrize("factor", [0, -1, 7, 2.0, "2", True])
def test_a_factor_must_divide_the_grid(factor: object) -> None:
    """Other factors are rejected, and the message lists those that divide it."""
    with pytest.raises(gp.InvalidInput, match="must divide the 60 x 40 cells: 1, 2, 4, 5, 10, 20"):
        gp.assess_terrain(np.zeros((40, 60)), 0.005).coarser(factor)  # type: ignore[arg-type]


def test_explanations_say_height_cause_and_verdict() -> None:
    """Safe ground, an edge, an unknown cell and a point off the grid."""
    heights = np.zeros((80, 80))
    heights[:, 60:] = 0.05
    heights[10, 10] = np.nan
    terrain = gp.assess_terrain(heights, 0.005, variance=np.full((80, 80), 1e-6))
    safe = terrain.explain(0.15, 0.2)
    assert "0.0 mm high (sigma 1.0 mm)" in safe
    assert "seen by 1 scan, now: traversable, score" in safe
    assert "not observed" in terrain.explain(0.0525, 0.0525)
    assert "is unknown" in terrain.explain(0.0525, 0.0525)
    assert "rises too much nearby" in terrain.explain(0.297, 0.2)
    assert "step 50" in terrain.explain(0.297, 0.2)
    assert "off the grid (x 0.000 ... 0.400" in terrain.explain(1.0, 0.2)
    assert "off the grid" in terrain.explain(np.nan, 0.2)


def boxed(noise: float, slope: float = 0.0) -> gp.TerrainGrid:
    """Floor with a box of 60 x 50 mm and 40 mm height, a hole 30 mm deep, and an unknown patch."""
    y, x = (np.mgrid[:108, :90] + 0.5) * 0.005
    heights = np.random.default_rng(4).normal(0, noise, x.shape) + slope * x
    heights[20:30, 20:32] += 0.040
    heights[70:80, 50:60] -= 0.030
    heights[40:44, 70:74] = np.nan
    return gp.assess_terrain(heights, 0.005, origin=(0.5, -0.27), variance=np.full(x.shape, max(noise, 1e-6) ** 2))


@pytest.mark.parametrize(("noise", "slope"), [(0.0, 0.0), (0.0003, 0.0), (0.0003, 0.08)])
def test_obstacles_are_found_with_position_height_and_outline(noise: float, slope: float) -> None:
    """Box and hole, on level and sloping floors: height to 0.3 mm, position to 1 mm, exact area."""
    found = boxed(noise, slope).obstacles()
    assert len(found) == 2
    box, hole = found
    assert box.height == pytest.approx(0.040, abs=3e-4)
    assert hole.height == pytest.approx(-0.030, abs=3e-4)
    np.testing.assert_allclose(box.position[:2], [0.63, -0.145], atol=1e-3)
    assert box.area == pytest.approx(0.060 * 0.050)
    assert area(box.outline) == pytest.approx(0.060 * 0.050, rel=1e-6)
    np.testing.assert_allclose(box.outline.min(axis=0), [0.60, -0.17], atol=1e-9)
    np.testing.assert_allclose(box.outline.max(axis=0), [0.66, -0.12], atol=1e-9)
    assert box.top_plane[0] == pytest.approx(slope, abs=0.01)
    assert box.sigma < 0.001
    assert box.hazard & Hazard.DROP
    assert not box.outline.flags.writeable


def area(outline: np.ndarray) -> float:
    """Signed area by the shoelace formula: positive for a counter-clockwise outline."""
    after = np.roll(outline, -1, axis=0)
    return float(np.sum(outline[:, 0] * after[:, 1] - after[:, 0] * outline[:, 1]) / 2)


def test_nothing_stands_on_an_empty_floor() -> None:
    """Noise, slope, and relief below 6 mm are no obstacles."""
    y, x = (np.mgrid[:60, :60] + 0.5) * 0.005
    noisy = np.random.default_rng(0).normal(0, 0.0005, x.shape) + 0.1 * x - 0.05 * y
    assert gp.assess_terrain(noisy, 0.005, variance=np.full(x.shape, 0.0005**2)).obstacles() == []
    low = np.zeros((60, 60))
    low[20:30, 20:30] = 0.005
    assert gp.assess_terrain(low, 0.005).obstacles() == []


@pytest.mark.parametrize("cells", [300, 4000, 40_000])
def test_the_floor_is_found_under_a_crowd_of_boxes(cells: int) -> None:
    """The floor is found with 45 % of the cells on boxes."""
    rng = np.random.default_rng(6)
    x, y = rng.uniform(0, 0.5, (2, cells))
    z = 0.02 + 0.05 * x - 0.03 * y + rng.normal(0, 0.0003, cells)
    on_box = rng.random(cells) < 0.45
    z[on_box] += rng.choice([0.02, 0.04, 0.08], on_box.sum())
    floor = fit_floor(x, y, z)
    assert floor is not None
    assert floor.a == pytest.approx(0.05, abs=1e-3)
    assert floor.b == pytest.approx(-0.03, abs=1e-3)
    assert floor.c == pytest.approx(0.02, abs=2e-4)
    assert floor.sigma == pytest.approx(0.0003, rel=0.2)


def test_a_floor_needs_three_points_off_a_line() -> None:
    """Two points, or many collinear ones, make no plane: no floor, no obstacle, no error."""
    line = np.linspace(0, 1, 20)
    assert fit_floor(line[:2], line[:2], line[:2]) is None
    assert fit_floor(line, 2 * line, np.zeros(20)) is None
    assert gp.assess_terrain(np.array([[0.0, 0.0, 0.5]]), 0.005).obstacles() == []


def test_the_recorded_boxes_are_found(paper_terrain: gp.TerrainGrid) -> None:
    """Five boxes of 10, 20, 40, 60 and 80 mm, each to half a millimetre."""
    heights = sorted(obstacle.height for obstacle in paper_terrain.obstacles())
    np.testing.assert_allclose(heights, [0.010, 0.020, 0.040, 0.060, 0.080], atol=5e-4)


def test_flags_are_printed_by_their_names(paper_terrain: gp.TerrainGrid) -> None:
    """`print(hazard_at(...))` shows the flags; the value stays a number."""
    assert [str(flag) for flag in (gp.Hazard.NONE, gp.Hazard.EDGE)] == ["NONE", "EDGE"]
    assert str(gp.Hazard.STEP | gp.Hazard.EDGE) == "STEP|EDGE" and int(gp.Hazard.STEP | gp.Hazard.EDGE) == 4608
    assert "EDGE" in str(paper_terrain.hazard_at(0.60, 0.10))


@pytest.mark.parametrize("wish", [("a", 0.0, 0.1), (0.7, None, 0.1), (0.7, 0.0, "wide"), (0.7, 0.0, [0.1])])
def test_a_wish_that_is_no_number_is_refused(paper_terrain: gp.TerrainGrid, wish: tuple) -> None:
    """With an InvalidInput, not an error from within numpy."""
    with pytest.raises(gp.InvalidInput, match="three numbers are needed"):
        paper_terrain.best_foothold(*wish)


def test_answers_are_printed_in_words(paper_terrain: gp.TerrainGrid) -> None:
    """Short numbers in millimetres, and the reason of a refusal."""
    foothold = paper_terrain.best_foothold(0.80, 0.00, 0.10)
    assert re.fullmatch(
        r"Foothold\(x=0.\d{4}, y=-?0.\d{4}, z=-?0.\d{4}, score=0.\d\d, value=0.\d\d, leg=None\)", repr(foothold)
    )
    assert re.fullmatch(r"ok, score 0\.\d\d", str(paper_terrain.check_foothold(foothold.x, foothold.y)))
    assert str(paper_terrain.check_foothold(0.80, 0.20)).startswith("refused: edge ")
    start = foothold.position + (0.0, 0.0, 0.05)
    assert re.fullmatch(
        r"ok, clearance \d+ mm", str(paper_terrain.check_path([start, start + (-0.10, 0.0, 0.0)], 0.03))
    )
    assert str(paper_terrain.check_path([start, start + (0.0, 0.2, 0.0)], 0.03)).startswith("refused: unknown ")
    assert re.fullmatch(
        r"refused: unknown \d+(\.\d+)? %, allowed 0 % \(of the sole: .+\)",
        str(paper_terrain.check_foothold(0.60, 0.265)),
    )


def test_answers_show_themselves_in_a_line(paper_terrain: gp.TerrainGrid, robot: gp.RobotModel) -> None:
    """The repr is short and contains no array."""
    foothold = paper_terrain.best_foothold(0.80, 0.00, 0.10)
    x, y, _ = foothold.position
    above = foothold.position + (0.0, 0.0, 0.05)
    region = paper_terrain.steppable_region(x, y, 0.1)
    shown = {
        repr(paper_terrain.check_foothold(x, y)): r"FootholdVerdict\(ok, score 0\.\d\d\)",
        repr(paper_terrain.check_foothold(0.80, 0.20)): r"FootholdVerdict\(refused: edge .*\)",
        repr(paper_terrain.check_foothold([x, 0.80], [y, 0.20])): r"FootholdVerdicts\(1 of 2 positions ok, leg=None\)",
        repr(
            paper_terrain.check_path([above, above + (-0.10, 0.0, 0.0)], 0.03)
        ): r"PathVerdict\(ok, clearance \d+ mm\)",
        repr(paper_terrain.swing(above, above + (-0.10, 0.0, 0.0), 0.03)): r"Swing\(ok, \d corners, clearance \d+ mm\)",
        repr(paper_terrain.swing(above, above + (0.0, 0.5, 0.0), 0.03)): r"Swing\(refused: .+\)",
        repr(region): r"SteppableRegion\(centre \(0\.\d{3}, -?0\.\d{3}\) m, [\d.]+ cm2, \d+ corners, "
        r"slope \d\.\d deg, sigma [\d.]+ mm, leg=None\)",
        repr(robot): r"RobotModel\('guara', legs lf rf lh rh, 16 joints, .*guara\)",
    }
    assert len(shown) == 8 and not [text for text, wanted in shown.items() if not re.fullmatch(wanted, text)]
