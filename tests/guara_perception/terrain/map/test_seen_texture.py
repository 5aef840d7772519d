"""Texture corrects errors of odometry; moving objects and bare floors do not move the map."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.ground_picture import GroundPicture
from guara_perception.images import to_grey
from guara_perception.simulation import specimen
from guara_perception.terrain.map.seen_texture import seen_after, view_of, visual_motion
from kinematics import PoseInOdom, RobotModel

MakeScan = Callable[..., gp.TerrainGrid]
# Motion of odometry between two pauses, with sigmas of 2 mm and 2 mrad.
SINCE_LAST = np.diag([0.002**2, 0.002**2, 0.001**2, 1e-8, 1e-8, 0.002**2])
PIXELS_A_METRE, FLOOR_FROM = 1000, (0.5, 1.0)
CAMERA_AT = (0.40, 0.0, 0.50)


def planar(x: float, y: float, yaw: float = 0.0) -> np.ndarray:
    """Motion along the floor."""
    transform = np.eye(4)
    transform[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    transform[:2, 3] = x, y
    return transform


def mottled(seed: int = 0) -> np.ndarray:
    """Grey levels of a floor of 3 m by 2 m, 1 mm per pixel, from 0.5 m behind the origin and 1 m beside it."""
    noise = np.random.default_rng(seed).standard_normal((2000, 3000)).astype(np.float32)
    soft = cv2.GaussianBlur(noise, (0, 0), 3.0)
    return np.asarray(90 + 9 * soft / soft.std(), np.float32)


@dataclass
class Walk:
    """Robot that walks over a level floor, with its images and its map."""

    robot: RobotModel
    make_scan: MakeScan
    floor: np.ndarray = field(default_factory=mottled)
    rng: np.random.Generator = field(default_factory=partial(np.random.default_rng, 5))

    def __post_init__(self) -> None:
        self.map, self.step, self.truth, self.odometry = gp.TerrainMap(self.robot), -1, np.eye(4), np.eye(4)
        calibration = specimen(self.robot, (640, 512), 0)
        self._camera = calibration.camera
        pose = self.robot.transform_camera_to_base.copy()
        pose[:3, 3] = CAMERA_AT
        self._pose = pose
        rows, columns = np.indices((512, 640))
        rays = self._camera.rays(np.stack((columns.ravel(), rows.ravel()), axis=1)) @ pose[:3, :3].T
        self._ground = pose[:2, 3] - rays[:, :2] / rays[:, 2:] * pose[2, 3]

    def picture(self) -> GroundPicture:
        """Present camera image, with sensor noise."""
        there = self._ground @ self.truth[:2, :2].T + self.truth[:2, 3]
        u, v = ((there + FLOOR_FROM) * PIXELS_A_METRE - 0.5).T.astype(np.float32).reshape(2, 512, 640)
        seen = cv2.remap(self.floor, u, v, cv2.INTER_LINEAR)
        noisy = seen + np.sqrt(0.25 + 0.011 * seen) * self.rng.standard_normal(seen.shape)
        return GroundPicture(np.clip(np.rint(noisy), 0, 255).astype(np.uint8), self._camera, self._pose)

    def pause(
        self,
        motion: np.ndarray,
        error: np.ndarray | None = None,
        picture: GroundPicture | str | None = None,
        since_last: np.ndarray = SINCE_LAST,
    ) -> gp.TerrainGrid:
        """Move by `motion`, which odometry reports, and then by `error`, which it does not; scan."""
        self.step += 1
        self.truth = self.truth @ motion @ (np.eye(4) if error is None else error)
        self.odometry = self.odometry @ motion
        heights = self.rng.normal(0.0, 2e-4, self.make_scan(0.0).geometry.shape)
        return self.map.update(
            self.make_scan(heights, step=self.step),
            PoseInOdom(self.odometry, (self.step + 1) * since_last, since_last),
            picture=self.picture() if picture is None else picture,
        )

    def off_by(self, fused: gp.TerrainGrid) -> np.ndarray:
        """Error of the map's pose: x, y [m] and yaw [rad]."""
        off = np.linalg.inv(self.truth) @ np.array(fused.metadata["transform_footprint_to_odom"])
        return np.array([*off[:2, 3], np.arctan2(off[1, 0], off[0, 0])])


@pytest.fixture
def walk(robot: RobotModel, make_scan: MakeScan) -> Iterator[Walk]:
    """Walk after its first pause."""
    started = Walk(robot, make_scan)
    started.pause(np.eye(4))
    yield started


@pytest.mark.slow
@pytest.mark.parametrize("error", [(0.003, 0.0, 0.0), (0.0, -0.003, 0.0), (-0.002, 0.002, 0.004)])
def test_a_motion_that_odometry_does_not_see_is_taken_off(walk: Walk, error: tuple[float, float, float]) -> None:
    """A level floor has no relief, but texture shows x, y and yaw to a fraction of a pixel."""
    fused = walk.pause(planar(0.035, 0.0), planar(*error))
    assert fused.metadata["visual_corners"] > 60
    assert "visual_refused" not in fused.metadata
    np.testing.assert_allclose(walk.off_by(fused), 0.0, atol=4e-4)
    sigmas = fused.metadata["sideways_correction_sigma"]
    assert max(sigmas[:2]) < 5e-4
    assert sigmas[2] < 6e-4


@pytest.mark.slow
@pytest.mark.parametrize("yaw", [0.025, -0.06])
def test_a_robot_that_stumbled_is_found_again(walk: Walk, yaw: float) -> None:
    """With an uncertain odometry, texture finds a shift of 15 mm with a rotation of 1.5 to 3.5 degrees."""
    fused = walk.pause(planar(0.035, 0.0), planar(-0.012, 0.009, yaw), since_last=400 * SINCE_LAST)
    assert "visual_refused" not in fused.metadata
    np.testing.assert_allclose(walk.off_by(fused), 0.0, atol=5e-4)


@pytest.mark.slow
def test_errors_do_not_add_up_at_each_pause(walk: Walk) -> None:
    """Feet slip by 8 % of the path at each of 16 pauses: the map stays within half a millimetre of the truth."""
    for _ in range(16):
        fused = walk.pause(planar(0.035, 0.0), planar(-0.0028, 0.0))
        assert np.abs(walk.off_by(fused)[:2]).max() < 5e-4
    assert walk.odometry[0, 3] - walk.truth[0, 3] == pytest.approx(16 * 0.0028)
    # Ground first seen at the far edge has drifted as little since: sigmas of pauses do not add up either.
    drift = walk.map.sideways_drift
    sigma = np.sqrt(drift.variances(drift.pauses[:1], np.array([0.9]), np.zeros(1), walk.odometry))
    assert 1e-4 < sigma.max() < 6e-4


@pytest.mark.slow
@pytest.mark.parametrize("aside", [0.005, 0.007, 0.010])
def test_a_floor_that_is_drawn_aside_does_not_take_the_map_along(walk: Walk, aside: float) -> None:
    """All ground in view moves sideways by 14 to 28 % of the path: the map follows for at most one pause."""
    for _ in range(10):
        fused = walk.pause(planar(0.035, 0.0), planar(0.0, aside))
        by_odometry = np.linalg.inv(walk.odometry) @ np.array(fused.metadata["transform_footprint_to_odom"])
        assert abs(by_odometry[1, 3]) < 1.01 * aside
    assert fused.metadata.get("visual_refused") or fused.metadata.get("registration_refused")


@pytest.mark.slow
@pytest.mark.parametrize(("share", "is_held"), [(0.3, True), (0.7, False)])
def test_what_moves_does_not_drag_the_map(walk: Walk, share: float, is_held: bool) -> None:
    """A mat over a third of the view is pulled sideways: the rest decides; if it covers more, odometry does."""
    first = int(1000 * (1 + 0.28 - 0.56 * share))
    walk.floor = walk.floor.copy()
    walk.floor[first:1300] = np.roll(walk.floor[first:1300], 5, axis=1)
    fused = walk.pause(planar(0.035, 0.0))
    if is_held:
        assert "visual_refused" not in fused.metadata
        np.testing.assert_allclose(walk.off_by(fused), 0.0, atol=6e-4)
    else:
        # The mat alone, moved by 5 mm, is within four sigma of odometry and moves the map no more than odometry allows.
        assert np.abs(walk.off_by(fused)[:2]).max() < 0.0055


@pytest.mark.slow
@pytest.mark.parametrize(("is_mat", "is_whole"), [(True, False), (False, True)])
def test_a_thing_on_a_bare_floor_is_not_the_whole_view(walk: Walk, is_mat: bool, is_whole: bool) -> None:
    """All corners of a small mat agree, but the mat may move, so its motion does not count as slip."""
    if is_mat:
        bare = np.full_like(walk.floor, 90)
        bare[900:1100, 1150:1350] = walk.floor[900:1100, 1150:1350]
        walk.floor = bare
    picture = walk.picture()
    view = view_of(picture, walk.make_scan(0.0))
    seen, is_new = seen_after(view, None, walk.truth, held=True)
    assert is_new
    prior, since = SINCE_LAST + 1e-6 * np.eye(6), 5e-6 * np.eye(3)
    found = visual_motion(view, seen, walk.truth, prior, since, np.zeros((3, 3)))
    assert found.refused is None
    assert found.is_whole is is_whole


@pytest.mark.slow
def test_a_shadow_of_the_robot_does_not_drag_the_map(walk: Walk) -> None:
    """A pattern that stays in the image while the robot walks is not ground."""
    pattern = 0.75 + 0.25 * (mottled(7)[:512, :640] > 90)
    for _ in range(6):
        moved = planar(0.035, 0.0)
        walk.truth = walk.truth @ moved
        shaded = walk.picture().grey.copy()
        walk.truth = walk.truth @ np.linalg.inv(moved)
        shaded[:, :220] = (shaded[:, :220] * pattern[:, :220]).astype(np.uint8)
        fused = walk.pause(
            moved, picture=GroundPicture(shaded, walk.picture().camera, walk.picture().transform_camera_to_footprint)
        )
        np.testing.assert_array_less(np.abs(walk.off_by(fused)), (6e-4, 6e-4, 1e-3))


@pytest.mark.slow
def test_texture_far_from_odometry_is_refused(walk: Walk) -> None:
    """20 mm are ten sigma: odometry is used, and the reason is reported."""
    fused = walk.pause(planar(0.035, 0.0), planar(0.02, 0.0))
    assert "contradict each other" in fused.metadata["visual_refused"]
    assert fused.metadata["sideways_correction"] == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make_floor", "told"),
    [
        (lambda: np.full((2000, 3000), 90, np.float32), "corners"),
        (lambda: mottled() / 12, "the laser-off picture is dark: its median level is 7 of 255"),
    ],
)
def test_without_texture_or_light_odometry_holds_the_map(
    robot: RobotModel, make_scan: MakeScan, make_floor: Callable[[], np.ndarray], told: str
) -> None:
    """A bare or dark floor moves nothing; sigma grows by 4 % of the path, because slip may keep its sign."""
    walk = Walk(robot, make_scan, make_floor())
    walk.pause(np.eye(4))
    for _ in range(8):
        fused = walk.pause(planar(0.035, 0.0))
        assert told in fused.metadata["visual_refused"]
    assert fused.metadata["sideways_correction"] == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    by_motions = np.sqrt(8 * (0.002**2 + 1e-8))
    assert fused.metadata["sideways_correction_sigma"][0] == pytest.approx(
        np.hypot(by_motions, 0.04 * 8 * 0.035), rel=0.02
    )
    assert fused.metadata["sideways_correction_sigma"][1] == pytest.approx(by_motions, rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("is_bare", [True, False])
def test_what_may_have_slipped_beyond_all_margins_is_stale(
    robot: RobotModel, make_scan: MakeScan, *, is_bare: bool
) -> None:
    """With slip of 4 %, ground last seen 0.5 m or more ago (2 sigma) exceeds margins of 40 mm: STALE.

    This holds for a walk of any length. Ground in view is fresh, and texture shows that nothing slipped.
    """
    walk = Walk(robot, make_scan, np.full((2000, 3000), 90, np.float32) if is_bare else mottled())
    for step in range(28):
        fused = walk.pause(planar(0.035, 0.0) if step else np.eye(4))
    hazard = fused.hazard_at(np.array([0.7, 0.3, -0.05, -0.2]), np.zeros(4))
    is_stale = (hazard & np.uint16(gp.Hazard.STALE)) != 0
    assert is_stale.tolist() == [False, False, is_bare, is_bare]


@pytest.mark.slow
def test_texture_that_comes_back_takes_slip_back(walk: Walk) -> None:
    """After slip over four pauses without an image, only the sigmas of four motions remain."""
    for _ in range(4):
        walk.pause(planar(0.035, 0.0), planar(-0.0014, 0.0), picture="lost")
    drift = walk.map.sideways_drift
    cell = np.array([0.8]), np.zeros(1)
    assert np.sqrt(drift.variances(drift.pauses[:1], *cell, walk.odometry)[0, 0]) > 0.04 * 0.14
    walk.pause(planar(0.035, 0.0), planar(-0.0014, 0.0))
    drift = walk.map.sideways_drift
    assert np.sqrt(drift.variances(drift.pauses[:1], *cell, walk.odometry)[0, 0]) == pytest.approx(0.004, rel=0.05)
    # Ground observed in between is displaced by the slip until then.
    assert np.sqrt(drift.variances(drift.pauses[4:5], *cell, walk.odometry)[0, 0]) > 0.04 * 0.14


@pytest.mark.slow
@pytest.mark.parametrize(("share", "learned"), [(0.0, 0.012), (0.08, 0.078), (-0.06, 0.059)])
def test_slip_is_learned_while_texture_shows_it(walk: Walk, share: float, learned: float) -> None:
    """After 0.98 m with texture, the sigma without it is that of feet that grip, or of the measured slip."""
    for _ in range(28):
        walk.pause(planar(0.035, 0.0), planar(-0.035 * share, 0.0))
    for _ in range(8):
        walk.pause(planar(0.035, 0.0), planar(-0.035 * share, 0.0), picture="lost")
    drift = walk.map.sideways_drift
    slip = drift.slip[-1] - drift.slip[-9]
    assert slip[0] == pytest.approx(learned * 8 * 0.035, rel=0.1) and slip[1] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.slow
def test_a_gap_is_told_and_texture_begins_anew(walk: Walk) -> None:
    """After two pauses without an image and half a metre, a new reference texture is taken."""
    for _ in range(2):
        fused = walk.pause(planar(0.25, 0.0), picture="the scan has no laser-off picture")
        assert fused.metadata["visual_refused"] == "the scan has no laser-off picture"
    assert "corners" in walk.pause(planar(0.01, 0.0)).metadata["visual_refused"]
    fused = walk.pause(planar(0.035, 0.0), planar(-0.003, 0.001))
    assert "visual_refused" not in fused.metadata
    np.testing.assert_allclose(walk.off_by(fused), 0.0, atol=5e-4)


@pytest.mark.slow
def test_one_refused_pause_costs_nothing_later(walk: Walk) -> None:
    """Texture from before an empty image corrects the pauses after it."""
    walk.pause(planar(0.035, 0.0))
    walk.pause(planar(0.035, 0.0), planar(-0.003, 0.0), picture="lost")
    fused = walk.pause(planar(0.035, 0.0), planar(-0.003, 0.0))
    np.testing.assert_allclose(walk.off_by(fused), 0.0, atol=5e-4)


@pytest.mark.slow
def test_a_map_with_pictures_goes_on_from_a_file(walk: Walk, tmp_path: Path) -> None:
    """Saved and loaded between two pauses: the same bytes as without a break."""
    walk.pause(planar(0.035, 0.0))
    walk.map.save(tmp_path / "map.npz")
    again = gp.TerrainMap.load(tmp_path / "map.npz")
    scan, moved = walk.make_scan(0.0, step=2), planar(0.07, 0.0)
    walk.truth = planar(0.068, 0.001)
    picture = walk.picture()
    expected, found = (
        each.update(scan, PoseInOdom(moved, 3 * SINCE_LAST, SINCE_LAST), picture=picture) for each in (walk.map, again)
    )
    assert expected.metadata["visual_corners"] > 60
    for name, layer in expected.layers.items():
        np.testing.assert_array_equal(layer, found.layer(name), err_msg=name)
    assert dict(expected.metadata) == dict(found.metadata)


def test_pictures_of_every_kind_become_grey() -> None:
    """Colour, one channel, and sixteen bits; no memory is shared with the camera's image."""
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    kinds = [grey, grey[..., None], np.dstack([grey] * 3), grey.astype(np.uint16) * 256]
    for picture in kinds:
        found = to_grey(picture)
        np.testing.assert_array_equal(found, grey)
        assert not np.shares_memory(found, picture)
