import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinematics import (
    ArgumentError,
    RobotModel,
    Stance,
    StanceError,
    StancePose,
    UnknownName,
    polygon_margin,
    stability_margin,
)
from tests.thorough import examples

SQUARE = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]


@pytest.mark.parametrize(
    ("point", "margin"),
    [((1.0, 1.0), 1.0), ((0.5, 1.0), 0.5), ((2.0, 1.0), 0.0), ((3.0, 1.0), -1.0), ((3.0, 3.0), -np.sqrt(2.0))],
)
def test_margin_of_a_square(point: tuple[float, float], margin: float) -> None:
    """Points inside, on the border, beside an edge and beside a corner."""
    assert polygon_margin(SQUARE, point) == pytest.approx(margin)


def test_what_is_no_polygon_holds_nothing() -> None:
    """One corner, two corners or collinear corners give the negative distance."""
    assert polygon_margin([[0.0, 0.0]], (3.0, 4.0)) == pytest.approx(-5.0)
    assert polygon_margin([[0.0, 0.0], [2.0, 0.0]], (1.0, 1.0)) == pytest.approx(-1.0)
    assert polygon_margin([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], (1.0, 0.0)) == pytest.approx(0.0)


@settings(max_examples=examples(60), derandomize=True, deadline=None)
@given(seed=st.integers(0, 1000), angle=st.floats(-3.0, 3.0))
def test_margin_does_not_depend_on_order_position_or_heading(seed: int, angle: float) -> None:
    """Permuted corners, rotated and shifted together with the point, give the same margin."""
    rng = np.random.default_rng(seed)
    corners, point = rng.normal(size=(5, 2)), rng.normal(size=2)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = rng.permutation(corners) @ rotation.T + (3.0, -1.0)
    assert polygon_margin(moved, rotation @ point + (3.0, -1.0)) == pytest.approx(
        polygon_margin(corners, point), abs=1e-9
    )


@settings(max_examples=examples(40), derandomize=True, deadline=None)
@given(seed=st.integers(0, 1000))
def test_another_foot_never_makes_it_worse(seed: int) -> None:
    """An additional corner never reduces the margin."""
    rng = np.random.default_rng(seed)
    corners, point = rng.normal(size=(5, 2)), rng.normal(size=2)
    assert polygon_margin(corners, point) >= polygon_margin(corners[:4], point) - 1e-12


def test_bad_arguments_are_refused() -> None:
    """Wrong shapes and NaN are rejected."""
    with pytest.raises(ArgumentError, match=r"corners have shape \(2, 3\)"):
        polygon_margin(np.zeros((2, 3)), (0.0, 0.0))
    with pytest.raises(ArgumentError, match=r"point has shape \(3,\)"):
        polygon_margin(SQUARE, (0.0, 0.0, 0.0))
    with pytest.raises(ArgumentError, match="finite numbers"):
        polygon_margin(SQUARE, (np.nan, 0.0))


def test_standing_on_four_feet(guara: RobotModel) -> None:
    """On four feet, the sides of the rectangle of soles are nearest; lifting a leg leaves almost no margin."""
    pose = guara.stance_pose(Stance(guara.posture("scan"), guara.legs))
    assert stability_margin(pose) == pytest.approx(0.180, abs=1e-6)
    centre = pose.state.centre_of_mass_in_base
    # The diagonal of the 0.60 x 0.36 m rectangle through the body's centre.
    offset = centre[0] * 0.36 / np.hypot(0.60, 0.36)
    for leg in guara.legs:
        expected = -offset if leg[1] == "f" else offset
        assert stability_margin(pose, lifted=leg) == pytest.approx(expected, abs=1e-6)


def test_a_shifted_body_gains_margin_on_one_side(robot: RobotModel, standing: StancePose) -> None:
    """Lifting a leg reduces the margin of every robot."""
    for leg in robot.legs:
        assert stability_margin(standing, lifted=leg) < stability_margin(standing)


def test_bad_legs_are_refused(guara: RobotModel) -> None:
    """A leg that does not exist or does not carry the body cannot be lifted."""
    pose = guara.stance_pose(Stance(guara.posture("scan"), guara.legs[:3]))
    with pytest.raises(UnknownName, match="unknown leg 'xx'"):
        stability_margin(pose, lifted="xx")
    with pytest.raises(StanceError, match="leg 'rh' does not carry the body; these do: lf, rf, lh"):
        stability_margin(pose, lifted="rh")
    alone = guara.stance_pose(Stance(guara.posture("scan"), ("lf",), (0.0, 0.0, -1.0)))
    with pytest.raises(StanceError, match="once leg 'lf' is lifted"):
        stability_margin(alone, lifted="lf")
