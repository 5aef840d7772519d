"""Every unknown cell has a cause, and the right one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.terrain.assessment.causes import NEARBY, LookPlan, behind_surface, lowest_ground, unknown_causes
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard
from tests.thorough import examples

GRID = GridGeometry((0.5, -0.05), 0.005, (20, 60))
SENSOR_ORIGINS = (np.array([0.4, 0.0, 0.5]), np.array([0.6, 0.0, 0.47]))


class Plan:
    """Plan with the same pair and visibility for every cell."""

    geometry = GRID

    def __init__(self, pair: int, seen: bool) -> None:
        self.pair, self.seen = pair, seen

    def pairs(self, cells: np.ndarray) -> np.ndarray:
        return np.full(cells.size, self.pair)

    def in_view(self, cells: np.ndarray) -> np.ndarray:
        return np.full(cells.size, self.seen)

    def sees(self, points: np.ndarray) -> np.ndarray:
        return np.full(len(points), self.seen)

    def is_lit(self, points: np.ndarray, _usable: np.ndarray) -> np.ndarray:
        return np.full(len(points), self.pair >= 0)

    def unmet(self, elevation: np.ndarray, _usable: np.ndarray, _laser_origin: np.ndarray) -> np.ndarray:
        return np.zeros(elevation.shape, bool)


ALL_SEEN = Plan(0, True)


def causes(elevation: np.ndarray, plan: Plan = ALL_SEEN, usable: bool = True, **more: object) -> np.ndarray:
    marks = more.get("marks", np.zeros(GRID.shape, np.uint16))
    origins = more.get("sensor_origins", SENSOR_ORIGINS)
    return unknown_causes(plan, origins, elevation, np.array([usable]), marks, more.get("own"))  # type: ignore[arg-type]


def flat(*unknown: tuple[int, int]) -> np.ndarray:
    elevation = np.zeros(GRID.shape)
    for cell in unknown:
        elevation[cell] = np.nan
    return elevation


def test_known_cells_carry_no_cause() -> None:
    """Marks of unusable returns do not affect known cells."""
    assert (causes(flat(), marks=np.full(GRID.shape, 16, np.uint16)) == 0).all()


def test_no_return_where_one_was_due_is_a_dropout() -> None:
    """Two usable stripes, a free line of sight, and no return."""
    found = causes(flat((10, 30)))
    assert found[10, 30] == Hazard.DROPOUT and found.sum() == Hazard.DROPOUT


def test_not_looked_at_is_unscanned() -> None:
    """No pair encloses the cell, the pair was not fired, or the camera does not see the cell."""
    nowhere, blind = Plan(-1, True), Plan(0, False)
    assert causes(flat((3, 3)), nowhere)[3, 3] == Hazard.UNSCANNED
    assert causes(flat((3, 3)), blind)[3, 3] == Hazard.UNSCANNED
    assert causes(flat((3, 3)), usable=False)[3, 3] == Hazard.UNSCANNED


@pytest.mark.parametrize("flag", [Hazard.AMBIGUOUS, Hazard.OUT_OF_RANGE])
def test_returns_that_may_not_be_used_name_the_cause(flag: Hazard) -> None:
    """An unusable return is a more specific cause than UNSCANNED."""
    marks = np.zeros(GRID.shape, np.uint16)
    marks[4, 5] = flag
    assert causes(flat((4, 5)), marks=marks)[4, 5] == flag


def test_shadow_of_a_measured_block_is_occluded_and_ends_where_geometry_says() -> None:
    """The camera's shadow behind a block of 80 mm extends h x / (H - h) beyond its far edge."""
    elevation = np.zeros(GRID.shape)
    elevation[:, 30:34] = 0.08
    far_edge = 0.5 + 34 * 0.005
    reach = 0.08 * (far_edge - 0.4) / (0.5 - 0.08)
    elevation[8:12, 34:58] = np.nan
    found = causes(elevation)
    cells = int(reach / 0.005)
    assert (found[10, 34 : 34 + cells - 1] == Hazard.OCCLUDED).all()
    assert (found[10, 34 + cells + 2 : 58] == Hazard.DROPOUT).all()


def test_laser_shadow_counts_too() -> None:
    """A cell that the camera sees but the laser cannot reach is OCCLUDED."""
    elevation = np.zeros(GRID.shape)
    elevation[:, 14:18] = 0.08
    elevation[:, 8:14] = np.nan
    assert causes(elevation, sensor_origins=SENSOR_ORIGINS[:1])[10, 13] == Hazard.DROPOUT
    assert causes(elevation, sensor_origins=SENSOR_ORIGINS[1:])[10, 13] == Hazard.OCCLUDED
    assert causes(elevation)[10, 13] == Hazard.OCCLUDED


def test_own_leg_in_the_way_is_self() -> None:
    """What the robot itself hides is not a property of the ground."""
    found = causes(flat((5, 5), (15, 50)), own=lambda _cells, points: points[:, 0] < 0.6)
    assert (found[5, 5], found[15, 50]) == (Hazard.SELF, Hazard.DROPOUT)


def test_every_unknown_cell_gets_a_cause_and_no_known_one() -> None:
    """Random heights and gaps: a cause exactly where the height is missing."""
    random = np.random.default_rng(0)
    elevation = np.where(random.random(GRID.shape) < 0.4, np.nan, random.uniform(0, 0.1, GRID.shape))
    assert ((causes(elevation) != 0) == np.isnan(elevation)).all()


def test_plan_finds_the_pair_that_passes_over_each_cell() -> None:
    """Vertical laser planes every 10 mm: the pair changes every two cells, none beyond the last plane."""
    x = 0.52 + 0.01 * np.arange(10)
    planes = np.column_stack((np.ones(10), np.zeros((10, 2)), -x))
    plan = LookPlan(GRID, planes, lambda points: points[:, :2], (640, 512))
    np.testing.assert_array_equal(plan.pairs(np.arange(3, 9)), [-1, 0, 0, 1, 1, 2])
    assert plan.pairs(np.array([30])) == -1
    np.testing.assert_array_equal(plan.pairs(60 + np.arange(3, 9)), plan.pairs(np.arange(3, 9)))


def test_plan_tells_the_cells_that_the_camera_sees() -> None:
    """Cells up to the outermost pixels; none beyond them or behind the camera."""
    columns = np.array([-0.1, 0.0, 639.0, 639.1, 5.0, 5.0, np.nan])
    rows = np.array([5.0, 0.0, 511.0, 5.0, -0.1, 511.1, np.nan])
    asked = []

    def project(points: np.ndarray) -> np.ndarray:
        asked.append(points)
        return np.column_stack((columns, rows))

    plan = LookPlan(GRID, np.array([[1.0, 0.0, 0.0, -0.6]]), project, (640, 512))
    cells = 60 * np.arange(7) + 4
    np.testing.assert_array_equal(plan.in_view(cells), [False, True, True, False, False, False, False])
    np.testing.assert_allclose(asked[0], [(0.5225, -0.0475 + 0.005 * k, 0.0) for k in range(7)], atol=1e-12)


@pytest.mark.slow
@given(st.integers(0, 100_000), st.integers(1, 200))
@settings(max_examples=examples(30), deadline=None, derandomize=True)
def test_a_line_of_sight_does_not_depend_on_the_others(seed: int, number: int) -> None:
    """Cells queried alone have the causes that they have among others."""
    random = np.random.default_rng(seed)
    elevation = np.where(random.random(GRID.shape) < 0.1, random.uniform(0, 0.2), 0.0)
    targets = np.column_stack((random.uniform(0.5, 0.8, number), random.uniform(-0.05, 0.05, number), np.zeros(number)))
    for sensor_origin in SENSOR_ORIGINS:
        together = behind_surface(elevation, targets, sensor_origin, GRID)
        alone = [behind_surface(elevation, target[None], sensor_origin, GRID)[0] for target in targets]
        np.testing.assert_array_equal(together, alone)


def plain_behind_surface(elevation: np.ndarray, target: np.ndarray, sensor: np.ndarray, grid: GridGeometry) -> bool:
    """Slow reference: steps of half a cell from the target to the sensor, or to the height of the highest cell."""
    share, step = 1.0, grid.resolution / 2 / max(float(np.hypot(*(sensor - target)[:2])), grid.resolution)
    share -= step / 2
    while share > 0 and (height := sensor[2] + share * (target[2] - sensor[2])) <= np.nanmax(elevation):
        x, y = sensor[:2] + share * (target - sensor)[:2]
        ix, iy = (int(np.floor((v - o) / grid.resolution)) for v, o in zip((x, y), grid.origin, strict=True))
        inside = 0 <= ix < elevation.shape[1] and 0 <= iy < elevation.shape[0]
        if inside and elevation[iy, ix] > height + 0.001:
            return True
        share -= step
    return False


@pytest.mark.parametrize("seed", range(3))
def test_lines_of_sight_are_those_of_a_plain_walk_along_them(seed: int) -> None:
    """Cells among boxes and unknown cells, and off the grid; except lines that graze a cell."""
    random = np.random.default_rng(seed)
    elevation = np.where(random.random(GRID.shape) < 0.1, random.uniform(0, 0.2), 0.0)
    elevation[random.random(GRID.shape) < 0.1] = np.nan
    targets = np.column_stack((random.uniform(0.45, 0.85, 200), random.uniform(-0.08, 0.08, 200), np.zeros(200)))
    for sensor in SENSOR_ORIGINS:
        found = behind_surface(elevation, targets, sensor, GRID)
        plain = [plain_behind_surface(elevation, target, sensor, GRID) for target in targets]
        assert 20 < found.sum() < 180
        assert np.count_nonzero(found != plain) <= 2


@pytest.mark.parametrize("known", [0.0, 0.01, 0.6])
def test_lowest_ground_is_that_of_a_plain_search_of_the_cells_nearby(known: float) -> None:
    """With few and many known cells, at the border too; height 0 if none is known nearby."""
    random = np.random.default_rng(3)
    elevation = np.where(random.random(GRID.shape) < known, random.normal(0, 0.05, GRID.shape), np.nan)
    cells = np.flatnonzero(np.isnan(elevation))
    for target, (iy, ix) in zip(lowest_ground(elevation, cells, GRID), np.argwhere(np.isnan(elevation)), strict=True):
        part = elevation[max(iy - NEARBY, 0) : iy + NEARBY + 1, max(ix - NEARBY, 0) : ix + NEARBY + 1]
        assert target[2] == np.nanmin(part, initial=np.inf) if np.isfinite(part).any() else target[2] == 0
        np.testing.assert_array_equal(target[:2], [axis[i] for axis, i in zip(GRID.centres(), (ix, iy), strict=True)])


LASER_ORIGIN = np.array([0.6, 0.0, 0.47])
STRIPES_AT = np.linspace(0.4955, 0.7955, 31)
"""x of the stripes on flat ground [m]."""


def swept(height: np.ndarray, dark: np.ndarray) -> tuple[np.ndarray, np.ndarray, LookPlan]:
    """Known heights of a sweep of `STRIPES_AT` over cells (ny, nx), mask of the lit cells, and its plan.

    Light is traced from the laser to the ground in steps of 1 mm or less. Cells are known where two neighbouring
    stripes returned at nearly the same height, and between them.
    """
    normal = np.column_stack((np.full(31, LASER_ORIGIN[2]), np.zeros(31), STRIPES_AT - LASER_ORIGIN[0]))
    planes = np.column_stack((normal, -normal @ LASER_ORIGIN))
    along_y = np.linspace(-0.12, 0.12, 121)
    x, y = np.meshgrid(STRIPES_AT, along_y, indexing="ij")
    ways = np.stack((x, y, np.zeros_like(x)), axis=-1) - LASER_ORIGIN
    points = LASER_ORIGIN + np.linspace(0.6, 1.3, 700)[:, None, None, None] * ways
    iy, ix = GRID.indices(points[..., 0], points[..., 1])
    inside = GRID.contains(iy, ix)
    iy, ix = iy.clip(0, GRID.shape[0] - 1), ix.clip(0, GRID.shape[1] - 1)
    is_met = inside & (points[..., 2] <= height[iy, ix])
    first = is_met.argmax(axis=0)[None]
    meets, iy, ix = is_met.any(axis=0), *(np.take_along_axis(each, first, axis=0)[0] for each in (iy, ix))
    lit = np.zeros(GRID.shape, bool)
    lit[iy[meets], ix[meets]] = True
    z = np.where(meets & ~dark[iy, ix], height[iy, ix], np.nan)
    with np.errstate(invalid="ignore"):
        linked = np.abs(np.diff(z, axis=0)) < 0.008
    elevation = np.full(GRID.shape, np.nan)
    for stripe, ray in np.argwhere(linked):
        for share in np.linspace(0, 1, 9):
            cell = [round((1 - share) * each[stripe, ray] + share * each[stripe + 1, ray]) for each in (iy, ix)]
            elevation[tuple(cell)] = (1 - share) * z[stripe, ray] + share * z[stripe + 1, ray]
    return elevation, lit, LookPlan(GRID, planes, lambda points: points[:, :2] + 1, (640, 512))


def plain_unmet(elevation: np.ndarray, planes: np.ndarray, grid: GridGeometry, laser: np.ndarray) -> np.ndarray:
    """Slow reference of the cells beyond the first and last stripe in each row."""
    (x, y), (ny, nx) = grid.centres(), grid.shape
    unmet = np.zeros(grid.shape, bool)
    for side in (1, -1):
        ends, tops = {}, [-0.2]
        for iy in range(ny):
            known = np.flatnonzero(np.isfinite(elevation[iy]))[::side]
            for ix in known[:1].tolist():
                height = elevation[iy, ix]
                crossings = [-(b * y[iy] + c * height + d) / a for a, b, c, d in planes]
                if side * (x[ix] - (min(crossings) if side > 0 else max(crossings))) <= grid.resolution / 2 + 0.0005:
                    ends[iy] = ix
                    tops.append(height)
        share = min(max((laser[2] - max(tops)) / (laser[2] + 0.2), 0), 1)
        for iy, ix in ends.items():
            passed = (laser[1] + (y[iy] - laser[1]) * share - y[0]) / grid.resolution
            other = min(max(round(passed), 0), ny - 1)
            if all(between in ends for between in range(min(iy, other), max(iy, other) + 1)):
                unmet[iy, slice(ix) if side > 0 else slice(ix + 1, nx)] = True
    return unmet


@pytest.mark.slow
def test_unmet_cells_are_those_of_a_plain_look_at_each_row() -> None:
    """Random ground with gaps, under stripes that begin and end near the ends of the known cells."""
    rng, count = np.random.default_rng(0), 0
    for _ in range(examples(400)):
        grid = GridGeometry((0.5, -0.1), 0.005, (int(rng.integers(1, 40)), int(rng.integers(7, 40))))
        elevation = rng.normal(0, rng.choice([0.0, 1e-3]), grid.shape)
        elevation[:, : rng.integers(1, 4)] = elevation[:, grid.shape[1] - rng.integers(1, 4) :] = np.nan
        elevation[rng.random(grid.shape) < rng.choice([0.0, 0.02])] = np.nan
        begin, end = 0.5 + rng.uniform(0.0, 0.04), 0.5 + 0.005 * grid.shape[1] - rng.uniform(0.0, 0.04)
        normals = (1, 0, 0) + rng.normal(0, 1e-3, (9, 3))
        plan = LookPlan(grid, np.column_stack((normals, -np.linspace(begin, end, 9))), lambda points: points, (9, 9))
        laser = np.array([0.45, rng.normal(0, 0.05), 0.5])
        usable = rng.random(8) < rng.choice([0.0, 0.9, 1.0, 1.0])
        found = plan.unmet(elevation, usable, laser)
        some = np.flatnonzero(usable)
        planes = plan.planes_in_footprint[[some[0], some[-1] + 1]] if some.size else np.empty((0, 4))
        expected = plain_unmet(elevation, planes, grid, laser) if some.size else np.zeros(grid.shape, bool)
        np.testing.assert_array_equal(found, expected)
        count += expected.any()
    assert count > 30


def test_ground_before_the_first_stripe_on_a_step_is_unscanned() -> None:
    """On ground 100 mm higher, all stripes miss the near edge: no light reached those cells."""
    height = np.full(GRID.shape, 0.1)
    elevation, lit, plan = swept(height, np.zeros(GRID.shape, bool))
    found = unknown_causes(plan, SENSOR_ORIGINS, elevation, np.ones(30, bool), np.zeros(GRID.shape, np.uint16))
    first, last = lit.any(axis=0).argmax(), 59 - lit.any(axis=0)[::-1].argmax()
    assert first == 3 and last <= 51
    assert (found[:, :first] == Hazard.UNSCANNED).all() and (found[:, last + 1 :] == Hazard.UNSCANNED).all()


@pytest.mark.parametrize("deep", [0.0, -0.06], ids=["mat", "dark pit"])
@pytest.mark.parametrize("base", [0.0, 0.06], ids=["floor", "step"])
def test_dark_ground_at_the_near_edge_is_a_dropout(deep: float, base: float) -> None:
    """Light reached it without a return, on the floor and on a step whose first stripe is absorbed too."""
    gx, gy = np.meshgrid(*GRID.centres())
    dark = (gx < 0.56) & (np.abs(gy) < 0.02)
    elevation, lit, plan = swept(np.where(dark, base + deep, base), dark)
    found = unknown_causes(plan, SENSOR_ORIGINS, elevation, np.ones(30, bool), np.zeros(GRID.shape, np.uint16))
    assert (lit & dark).sum() > 20
    assert (found[lit & dark] & (Hazard.DROPOUT | Hazard.OCCLUDED)).all()
    assert (found[lit & dark] == Hazard.DROPOUT).mean() > 0.9


def test_light_from_the_side_reaches_dark_ground_before_a_box() -> None:
    """The first stripe ends on the box, but passes beside it to the ground in front."""
    gx, gy = np.meshgrid(*GRID.centres())
    beside = gy > 0.04
    dark = beside & (gx < 0.515)
    elevation, lit, plan = swept(np.where(beside & ~dark, 0.1, 0.0), dark)
    assert (lit & dark).any()
    assert not (plan.unmet(elevation, np.ones(30, bool), LASER_ORIGIN) & lit).any()


def random_ground(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Boxes, pits and dark mats, mostly at the near edge: heights (ny, nx), and mask of the dark cells."""
    random = np.random.default_rng(seed)
    gx, gy = np.meshgrid(*GRID.centres())
    height, dark = np.full(GRID.shape, random.choice([0.0, 0.05, 0.1])), np.zeros(GRID.shape, bool)
    for _ in range(random.integers(0, 6)):
        x, y = random.choice([random.uniform(0.48, 0.56), random.uniform(0.5, 0.8)]), random.uniform(-0.06, 0.06)
        there = (np.abs(gx - x) < random.uniform(0.005, 0.08)) & (np.abs(gy - y) < random.uniform(0.005, 0.06))
        if random.random() < 0.5:
            height[there] = random.uniform(-0.08, 0.12)
        else:
            dark |= there
    return height, dark


@pytest.mark.slow
@given(st.integers(0, 100_000))
@settings(max_examples=examples(60), deadline=None, derandomize=True)
def test_only_ground_without_light_counts_as_not_met(seed: int) -> None:
    """On any ground, no cell that light reached counts as unmet."""
    height, dark = random_ground(seed)
    elevation, lit, plan = swept(height, dark)
    usable = np.ones(30, bool)
    unmet = plan.unmet(elevation, usable, LASER_ORIGIN)
    assert not (unmet & lit).any()
    assert not (unmet & np.isfinite(elevation)).any()


CAMERA = np.array([0.65, 0.0, 0.5])


def narrow(points: np.ndarray) -> np.ndarray:
    """Pixels of a camera that sees |y| < 0.05 of the floor, and 0.04 at a height of 0.1."""
    return np.asarray(320 + 3200 * (points[:, :2] - CAMERA[:2]) / (CAMERA[2] - points[:, 2:]) * (0.1, 1.0))


@pytest.mark.parametrize(("known", "cause"), [(0.04, Hazard.UNSCANNED), (0.02, Hazard.DROPOUT)], ids=["ground", "box"])
def test_raised_ground_is_seen_over_a_smaller_area(known: float, cause: Hazard) -> None:
    """On a wide step, the border of the floor is out of view; beside a narrow box the floor is in view."""
    planes = np.column_stack((np.ones(31), np.zeros((31, 2)), -STRIPES_AT))
    plan, (x, y) = LookPlan(GRID, planes, narrow, (641, 641)), GRID.centres()
    elevation = np.where(np.abs(y)[:, None] < known, 0.1, np.full(GRID.shape, np.nan))
    found = unknown_causes(plan, (CAMERA, CAMERA), elevation, np.ones(30, bool), np.zeros(GRID.shape, np.uint16))
    assert (found[np.abs(y) > 0.041][:, x < 0.79] == cause).all()


@pytest.mark.slow
@given(st.integers(0, 100_000))
@settings(max_examples=examples(60), deadline=None, derandomize=True)
def test_only_ground_out_of_view_is_unscanned(seed: int) -> None:
    """On any ground, no cell that light reached in the view of a narrow camera is UNSCANNED."""
    height, dark = random_ground(seed)
    elevation, lit, wide = swept(height, dark)
    plan, cells = LookPlan(GRID, wide.planes_in_footprint, narrow, (641, 641)), np.arange(GRID.size)
    points = np.stack((*np.meshgrid(*GRID.centres()), height), axis=-1).reshape(-1, 3)
    in_view = plan.sees(points)
    looked_at = lit.ravel() & in_view & ~behind_surface(height, points, CAMERA, GRID) & (plan.pairs(cells) >= 0)
    elevation[~in_view.reshape(GRID.shape)] = np.nan
    origins, nothing = (CAMERA, LASER_ORIGIN), np.zeros(GRID.shape, np.uint16)
    found = unknown_causes(plan, origins, elevation, np.ones(30, bool), nothing).ravel()
    assert not (found[looked_at & plan.in_view(cells)] == Hazard.UNSCANNED).any()
