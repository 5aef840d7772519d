"""Detection of a hanging foot by the heights of the others, by balance, then by the commanded attitude."""

import numpy as np

from kinematics.unloaded import FourFeet, find_unloaded_foot

SOLES = np.array([[0.3, 0.18, -0.36], [0.3, -0.18, -0.36], [-0.3, 0.18, -0.36], [-0.3, -0.18, -0.36]])
UP = np.array([0.0, 0.0, 1.0])


def four_feet(raised: float, centre: tuple[float, float] = (0.0, 0.0), up: np.ndarray | None = None) -> FourFeet:
    soles = SOLES.copy()
    soles[0, 2] += raised
    return FourFeet(soles, np.tile(np.eye(3) * 1e-6, (4, 1, 1)), np.array([*centre, -0.03]), 0.010, up, 0.00175)


def test_level_feet_all_stand() -> None:
    """Of four coplanar soles, no foot hangs."""
    assert find_unloaded_foot(four_feet(0.0), 3.5) is None


def test_a_gap_within_noise_does_not_count() -> None:
    """A foot that hangs by less than the noise of four soles (2 mm times 3.5) is kept; by more it is found."""
    assert find_unloaded_foot(four_feet(0.006), 3.5) is None
    assert find_unloaded_foot(four_feet(0.008), 3.5) == 0


def test_balance_decides_where_the_vertical_is_unknown() -> None:
    """If the centre of mass is well on one side, the foot on the other side of the diagonal hangs."""
    assert find_unloaded_foot(four_feet(0.02, centre=(-0.05, -0.05)), 3.5) == 0
    assert find_unloaded_foot(four_feet(0.02, centre=(0.05, 0.05)), 3.5) == 3


def test_a_body_near_balance_is_taken_as_commanded_level() -> None:
    """If the centre of mass is on the diagonal, the foot whose absence leaves the body level hangs."""
    assert find_unloaded_foot(four_feet(0.02, centre=(0.003, 0.003)), 3.5) == 0


def test_the_heights_of_the_others_decide_where_the_vertical_is_known() -> None:
    """With gravity, the foot above three level ones hangs, whatever the balance."""
    assert find_unloaded_foot(four_feet(0.02, centre=(0.05, 0.05), up=UP), 3.5) == 0


def test_uneven_ground_is_not_a_hanging_foot() -> None:
    """With gravity, and no three feet level, there is no evidence of a hanging foot."""
    feet = four_feet(0.02, up=UP)
    feet.soles[3, 2] += 0.03
    assert find_unloaded_foot(feet, 3.5) is None


def test_three_soles_on_a_line_say_nothing_of_the_fourth() -> None:
    """Three collinear soles define no plane; the other triples do."""
    feet = four_feet(0.0)
    feet.soles[1] = (feet.soles[0] + feet.soles[2]) / 2
    assert find_unloaded_foot(feet, 3.5) is None
    feet.soles[1, 2] += 0.03
    assert find_unloaded_foot(feet, 3.5) == 1
