"""The wide area of a scan: ground beside the footprint, for the map; inside, heights are the same."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.app.node.live_scan import LiveScan
from guara_perception.app.node.sweep import Swept
from guara_perception.scanning.pictures import with_pictures
from guara_perception.settings import Settings
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from kinematics import PoseInOdom
from tests.calibrated_session import calibrated_session
from tests.guara_perception.recordings import guara, recorded_scan, truth
from tests.thorough import examples, further

ROWS = slice(16, 124)  # of the wide grid, those of the footprint; it has 80 mm more on each side


def processor(name: str, lost: frozenset[int] = frozenset(), blank: frozenset[int] = frozenset()) -> gp.ScanProcessor:
    """Processor with a recorded scan, without the lost stripes and with blank frames for some."""
    scan, frames = recorded_scan(name)
    made = gp.ScanProcessor(truth(), guara(), scan.stance, scan.mode)
    for index, on, off in frames:
        if index not in lost:
            made.add(index, np.zeros_like(on) if index in blank else on, off)
    return made


@pytest.fixture(scope="module", params=["paper", "tilt"])
def both(request: pytest.FixtureRequest) -> tuple[gp.TerrainGrid, gp.TerrainGrid]:
    """Footprint and wide grid of one scan."""
    made = processor(request.param)
    return made.finish(), made.finish("wide")


@pytest.mark.slow
def test_it_is_as_wide_as_the_map_and_as_deep_as_the_footprint(both: tuple[gp.TerrainGrid, gp.TerrainGrid]) -> None:
    """Cells of both coincide."""
    footprint, wide = both
    assert (footprint.shape, wide.shape) == ((108, 90), (140, 90))
    assert wide.origin == pytest.approx((footprint.origin[0], Settings.of(guara()).map_y[0]))
    assert wide.resolution == footprint.resolution


def test_inside_it_says_what_the_footprint_says(both: tuple[gp.TerrainGrid, gp.TerrainGrid]) -> None:
    """The same heights to the bit; every safe cell of the footprint stays safe, for no window has lost a cell."""
    footprint, wide = both
    for name in ("elevation", "variance", "elevation_min", "elevation_max"):
        np.testing.assert_array_equal(wide.layers[name][ROWS], footprint.layers[name])
    assert not ((footprint.traversability > 0) & ~(wide.traversability[ROWS] > 0)).any()


def test_its_pictures_show_its_own_area() -> None:
    """Each known pixel has the height of the cell beneath it, in both areas; none lies over an unknown cell."""
    made = processor("paper")
    for area in ("footprint", "wide"):
        terrain = made.finish(area)
        ortho = with_pictures(terrain, made).pictures["ortho_image_mm"]
        assert not ortho.flags.writeable
        (ny, nx), (rows, columns) = terrain.shape, ortho.shape
        iy = ((np.arange(columns) + 0.5) * ny / columns).astype(int)
        ix = ((np.arange(rows) + 0.5) * nx / rows).astype(int)
        beneath = 1e3 * terrain.elevation[iy[None, :], ix[:, None]]
        shown = np.isfinite(ortho)
        assert shown.mean() > 0.5 and np.isfinite(beneath[shown]).all()
        assert (np.abs(ortho - beneath)[shown] > 5.0).mean() < 0.01


def test_it_knows_more_the_farther_away(both: tuple[gp.TerrainGrid, gp.TerrainGrid]) -> None:
    """The farther the ground, the wider the camera's view of it; what it cannot see is unknown."""
    _, wide = both
    beside = np.isfinite(np.delete(wide.elevation, ROWS, axis=0))
    assert beside[:, -20:].mean() > max(0.5, beside[:, :10].mean() + 0.1)
    assert (np.isnan(wide.elevation) == ((wide.hazard & UNKNOWN_MASK) != 0)).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dark", *further("paper")])
@given(data=st.data())
@settings(max_examples=examples(6), deadline=None, derandomize=True)
def test_losing_stripes_or_frames_makes_no_cell_of_it_safe(name: str, data: st.DataObject) -> None:
    """What holds for the footprint holds for the wide grid."""
    indices = [index for index, _, _ in recorded_scan(name)[1]]
    lost = data.draw(st.frozensets(st.sampled_from(indices), max_size=8))
    blank = data.draw(st.frozensets(st.sampled_from(indices), max_size=4)) - lost
    less, whole = processor(name, lost, blank).finish("wide"), processor(name).finish("wide")
    assert not ((less.traversability > 0) & ~(whole.traversability > 0)).any()
    assert not (np.isfinite(less.elevation) & ~np.isfinite(whole.elevation)).any()


@pytest.mark.slow
def test_heights_beside_the_footprint_are_as_good_as_inside(tmp_path_factory: pytest.TempPathFactory) -> None:
    """With a calibration from crosses and a plate, against the true one: 99 % within 0.3 mm there too."""
    of_truth = processor("tilt").finish("wide")
    calibration = calibrated_session(tmp_path_factory).calibration
    again = gp.process_scan(recorded_scan("tilt")[0], calibration, guara(), area="wide", pictures=False)
    difference = np.abs(np.asarray(again.elevation - of_truth.elevation, np.float64))
    for rows in (np.delete(difference, ROWS, axis=0), difference[ROWS]):
        known = rows[np.isfinite(rows)]
        assert known.size > 500
        assert np.quantile(known, 0.99) < 0.0003


def test_the_map_knows_more_ground_with_it(both: tuple[gp.TerrainGrid, gp.TerrainGrid]) -> None:
    """All that it knows from the footprint's grid, and more; soles can stand nearer to its sides."""
    fused = [gp.TerrainMap(guara()).update(grid, PoseInOdom(np.eye(4), 1e-8 * np.eye(6))) for grid in both]
    free = [grid.traversability > 0 for grid in fused]
    assert not (free[0] & ~free[1]).any()
    assert np.count_nonzero(free[1]) > 1.2 * np.count_nonzero(free[0])


def test_a_node_gives_the_map_the_wide_grid_with_the_report_of_the_published_one() -> None:
    """Of a coarse scan extended by some stripes between, both grids count; lost cells are those of the wide one."""
    scan, frames = recorded_scan("paper")
    coarse = gp.ScanProcessor(truth(), guara(), scan.stance, "coarse")
    for index, on, off in frames[::2]:
        coarse.add(index, on, off)
    standard = coarse.extended()
    for index, on, off in frames[1:20:2]:
        standard.add(index, on, off)
    published = gp.refined(coarse.finish(), standard.finish())
    swept = Swept(published, LiveScan(0, 1, 0.0, (), stopped_early=False, failed=False), standard, coarse)
    wide = swept.wide(published)
    assert wide.metadata["known"] == published.metadata["known"]
    for name in ("elevation", "elevation_max"):
        np.testing.assert_array_equal(wide.layers[name][ROWS], published.layers[name])


def test_a_finished_scan_gives_its_memory_back_at_once() -> None:
    """It contains no reference cycle, so that no garbage collector is needed to free it."""
    made = processor("paper", lost=frozenset(range(0, 70, 6)))
    made.finish(), made.finish("wide"), made.pairs
    gone = weakref.ref(made)
    surface = weakref.ref(made._surface)
    gc.disable()
    try:
        del made
        assert gone() is None and surface() is None
    finally:
        gc.enable()


def test_another_area_is_refused() -> None:
    """The message lists what is allowed, before anything is read."""
    with pytest.raises(gp.InvalidInput, match="area is 'broad', allowed: footprint, wide"):
        gp.process_scan("nowhere", area="broad")
    with pytest.raises(gp.InvalidInput, match="area is 'map', allowed: footprint, wide"):
        processor("paper").finish("map")
