import numpy as np
import pytest

from kinematics.footholds import Footholds, first_footholds
from kinematics.stayed_feet import find_stayed_feet

LEGS = ("lf", "rf", "lh", "rh")
SOLES = np.array([[0.3, 0.18, 0.0], [0.3, -0.18, 0.01], [-0.3, 0.18, -0.02], [-0.25, -0.18, 0.0]])
READINGS = np.column_stack([SOLES, [0.0, 0.02, -0.01, 0.0]])
NOISE = np.tile(np.diag([1e-6, 1e-6, 1e-6, 1e-5]), (4, 1, 1))
FIRST = first_footholds(LEGS, READINGS, NOISE)


def turn(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def seen_from(readings: np.ndarray, angle: float, shift: tuple[float, float, float]) -> np.ndarray:
    """Readings as seen from a footprint that is rotated by an angle and displaced by a shift."""
    result = readings.copy()
    result[:, :2] = (readings[:, :2] - shift[:2]) @ turn(angle)
    result[:, 2] -= shift[2]
    return result


@pytest.mark.parametrize("stayed", [LEGS, ("lf", "rh"), ("rf", "lh", "rh")])
def test_a_known_motion_is_found(stayed: tuple[str, ...]) -> None:
    """Two or more feet give heading, shift and rise exactly, and the footholds do not move."""
    now = seen_from(READINGS, 0.11, (0.035, -0.01, 0.02))
    fit, footholds = FIRST.after_pause(stayed, LEGS, now, NOISE)
    expected = np.eye(4)
    expected[:2, :2], expected[:3, 3] = turn(0.11), (0.035, -0.01, 0.02)
    np.testing.assert_allclose(fit.transform_footprint_to_odom, expected, atol=1e-12)
    np.testing.assert_allclose(footholds.positions, READINGS, atol=1e-12)
    assert fit.residual < 1e-12 and fit.misfit == 1.0


@pytest.mark.heavy
@pytest.mark.slow
def test_covariances_agree_with_sampling() -> None:
    """After two pauses, one of them after a step, the covariances of footprint and footholds agree with sampling."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(4, 4)) * 1e-3
    noise = np.tile(root @ root.T + np.diag([1e-7] * 4), (4, 1, 1))
    roots = np.linalg.cholesky(noise[0])
    after_swing = READINGS.copy()
    after_swing[1, 0] += 0.14
    poses, positions = [], []
    for _ in range(1000):

        def read(readings: np.ndarray, *seen: object) -> np.ndarray:
            return seen_from(readings, *seen) + rng.normal(size=(4, 4)) @ roots.T  # type: ignore[arg-type]

        footholds = first_footholds(LEGS, READINGS + rng.normal(size=(4, 4)) @ roots.T, noise)
        stayed = ("lf", "lh", "rh")
        _, footholds = footholds.after_pause(stayed, LEGS, read(after_swing, 0.02, (0.03, 0.0, 0.0)), noise)
        fit, footholds = footholds.after_pause(LEGS, LEGS, read(after_swing, 0.05, (0.06, 0.01, 0.0)), noise)
        transform = fit.transform_footprint_to_odom
        poses.append([*transform[:3, 3], np.arctan2(transform[1, 0], transform[0, 0])])
        positions.append(footholds.positions.ravel())
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance)), np.std(poses, axis=0), rtol=0.10)
    np.testing.assert_allclose(np.sqrt(np.diag(footholds.covariance)), np.std(positions, axis=0), rtol=0.10)
    assert np.linalg.eigvalsh(footholds.covariance)[0] > 0.0


def test_footholds_become_more_certain_with_time() -> None:
    """Repeated observation makes a foothold more certain, never less."""
    footholds, last = FIRST, np.diag(FIRST.covariance)
    for _ in range(4):
        _, footholds = footholds.after_pause(LEGS, LEGS, READINGS, NOISE)
        assert np.all(np.diag(footholds.covariance) <= last + 1e-18)
        last = np.diag(footholds.covariance)


def test_a_foot_that_crept_pulls_less() -> None:
    """One of four feet that creeps by 10 mm moves the result less than in plain least squares, and widens it."""
    now = READINGS.copy()
    now[0, 0] -= 0.010
    fit, _ = FIRST.after_pause(LEGS, LEGS, now, NOISE)
    assert abs(fit.transform_footprint_to_odom[0, 3]) < 0.75 * 0.010 / 4.0
    assert fit.misfit > 3.0


def test_feet_that_slipped_stand_where_they_are_now() -> None:
    """Footholds that no longer fit do not affect the next pause, in which nothing moves."""
    now = READINGS.copy()
    now[0, 0] -= 0.030
    now[3, 1] += 0.025
    slipped, footholds = FIRST.after_pause(LEGS, LEGS, now, NOISE)
    assert slipped.misfit > 3.0
    still, _ = footholds.after_pause(("lf", "rf", "lh"), LEGS, now, NOISE)
    before, after = slipped.transform_footprint_to_odom, still.transform_footprint_to_odom
    np.testing.assert_allclose(after, before, atol=1e-9)
    assert still.misfit == 1.0
    np.testing.assert_array_equal(still.covariance, still.covariance.T)
    assert (np.diag(still.covariance) > 0.9 * np.diag(slipped.covariance)).all()


def test_the_pitch_of_a_standing_sole_shows_the_noise_of_its_position() -> None:
    """If noise moves position and pitch of a sole together, a change of pitch corrects the position."""
    noise = np.tile(np.diag([1e-7, 1e-6, 1e-6, 1e-7]), (4, 1, 1))
    by_joint = np.array([0.23, 0.0, 0.0, 1.0]) * 0.0035
    noise += np.outer(by_joint, by_joint)
    now = READINGS.copy()
    now += 2.0 * by_joint
    fit, _ = first_footholds(LEGS, READINGS, noise).after_pause(LEGS, LEGS, now, noise)
    assert abs(fit.transform_footprint_to_odom[0, 3]) < 0.1 * 2.0 * by_joint[0]
    blind = noise.copy()
    blind[:, 3], blind[:, :, 3] = 0.0, 0.0
    blind[:, 3, 3] = 1.0
    fit, _ = first_footholds(LEGS, READINGS, blind).after_pause(LEGS, LEGS, now, blind)
    assert abs(fit.transform_footprint_to_odom[0, 3]) == pytest.approx(2.0 * by_joint[0], rel=1e-3)


def test_a_sole_that_rocked_says_nothing_by_its_pitch() -> None:
    """A pitch that changed by far more than the noise does not move the footprint."""
    noise = NOISE + np.outer((0.0008, 0.0, 0.0, 0.0035), (0.0008, 0.0, 0.0, 0.0035))
    now = READINGS.copy()
    now[2, 3] += 0.2
    fit, _ = first_footholds(LEGS, READINGS, noise).after_pause(LEGS, LEGS, now, noise)
    np.testing.assert_allclose(fit.transform_footprint_to_odom, np.eye(4), atol=1e-5)


def test_feet_that_no_longer_stand_are_forgotten() -> None:
    """The footholds are those of the present supporting feet, in their order."""
    legs = ("rh", "lf", "lh")
    rows = [LEGS.index(leg) for leg in legs]
    _, footholds = FIRST.after_pause(("lf", "rh"), legs, READINGS[rows], NOISE[rows])
    assert isinstance(footholds, Footholds) and footholds.legs == legs
    np.testing.assert_allclose(footholds.positions, READINGS[rows], atol=1e-12)


def test_what_other_feet_say_is_a_displacement_that_nothing_reduces() -> None:
    """One foot slides perpendicular to the line to the foot that stays.

    The displacement according to the other feet is one sigma, and later readings of standing feet change neither it nor
    the footholds.
    """
    now = READINGS.copy()
    now[0, :2] += (0.0, 0.05)
    fit, footholds = FIRST.after_pause(("rf", "rh"), LEGS, now, NOISE, instead=[("lf", "lh")])
    by_lf, _ = FIRST.after_pause(("lf", "lh"), LEGS, now, NOISE)
    there = by_lf.transform_footprint_to_odom
    way = np.array([*there[:2, 3], 0.0, np.arctan2(there[1, 0], there[0, 0])])
    np.testing.assert_allclose(fit.by_slides, np.outer(way, way), atol=1e-6)
    np.testing.assert_allclose(footholds.by_slides, fit.by_slides, atol=1e-6)
    for _ in range(3):
        _, footholds = footholds.after_pause(LEGS, LEGS, seen_from(now, 0.1, (0.2, 0.0, 0.0)), NOISE)
    np.testing.assert_allclose(footholds.by_slides, fit.by_slides, atol=1e-6)
    # Farther along the path, the rotation displaces the footprint sideways.
    assert footholds.slides_at(np.array([1.0, 0.0]))[1, 1] == pytest.approx((way[1] + way[3]) ** 2, rel=1e-3)


def stayed(now: np.ndarray, before: np.ndarray, turn_limit: float = 0.26) -> list[tuple[int, ...]]:
    return find_stayed_feet(now, NOISE[:, :3, :3], before, NOISE[:, :3, :3], slip_sigmas=4.5, turn_limit=turn_limit)


def test_the_foot_that_swung_is_distinguished_from_those_that_stayed() -> None:
    """Whatever the motion of the body, the one foot of four that swung is excluded."""
    for swung in range(4):
        before = SOLES.copy()
        before[swung, 0] -= 0.14
        now = seen_from(READINGS, 0.05, (-0.035, 0.01, 0.0))[:, :3]
        assert stayed(now, before) == [tuple(foot for foot in range(4) if foot != swung)]


def test_a_swing_that_keeps_a_distance_is_seen_by_its_turn() -> None:
    """A foot that passes its neighbour keeps the distance, but the line between them rotates too far."""
    before, now = SOLES[:2].copy(), SOLES[:2].copy()
    before[1, 0], now[1, 0] = 0.23, 0.37
    assert stayed(now, before) == []
    assert stayed(now, before, turn_limit=3.0) == [(0, 1)]


def test_a_foot_that_slides_across_a_line_may_have_stayed() -> None:
    """Both equally large pairs are returned, the likelier one first."""
    now = SOLES[:3].copy()
    now[0, 1] += 0.05
    found = stayed(now, SOLES[:3])
    assert found[0] == (1, 2) and set(found) == {(1, 2), (0, 2)}


def test_nothing_in_common_means_none() -> None:
    """With fewer than two feet, none can be shown to have stayed."""
    assert stayed(SOLES[:1], SOLES[:1]) == []
    assert stayed(SOLES[:0], SOLES[:0]) == []
