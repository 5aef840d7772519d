import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from kinematics import RobotModel, load_robot
from kinematics.leg import NumericLeg, find_leg_geometry
from tests.thorough import examples

GUARA = load_robot("guara")


def pose_of(robot: RobotModel, leg: str, positions: np.ndarray) -> tuple[np.ndarray, float]:
    """Sole centre and sole pitch (in the leg's plane) from Pinocchio."""
    joints = robot.posture("scan")
    joints.update(zip(robot.tree.leg(leg).joints, positions.tolist(), strict=True))
    state = robot.state(joints)
    return state.soles_in_base([leg])[0], float(positions[1:].sum())


@settings(max_examples=examples(80), derandomize=True, deadline=None)
@given(seed=st.integers(0, 100_000), leg=st.sampled_from(GUARA.legs))
def test_closed_form_agrees_with_pinocchio(seed: int, leg: str) -> None:
    """Forward kinematics agrees to 1e-12 m, and inverse kinematics returns the same sole and pitch."""
    geometry = find_leg_geometry(GUARA.tree, leg)
    assert geometry is not None
    positions = np.random.default_rng(seed).uniform(geometry.lower, geometry.upper)
    sole, pitch = pose_of(GUARA, leg, positions)
    assume(sole[2] < -0.02)  # For a sole above the hip, another roll is the solution.
    np.testing.assert_allclose(geometry.soles_in_base(positions), sole, atol=1e-12)
    found = geometry.solve(sole[None], np.array([pitch]))[0]
    assert not np.isnan(found).any()
    np.testing.assert_allclose(geometry.soles_in_base(found), sole, atol=1e-12)
    assert np.remainder(found[1:].sum() - pitch + np.pi, 2 * np.pi) - np.pi == pytest.approx(0.0, abs=1e-12)
    if positions[2] > 1e-3:
        np.testing.assert_allclose(found, positions, atol=1e-9)


def test_soles_out_of_reach_have_no_solution() -> None:
    """Soles that are too far, too near or unknown give NaN for all joints."""
    geometry = find_leg_geometry(GUARA.tree, "lf")
    assert geometry is not None
    soles = geometry.hip + [[0.0, 0.0, -0.41], [0.4, 0.0, -0.3], [np.nan, 0.0, -0.3]]
    assert np.isnan(geometry.solve(soles, np.zeros(3))).all()


def test_legs_are_recognised_by_geometry_not_by_name(
    broken_folder: Callable[..., Path], guara: RobotModel, tmp_path: Path
) -> None:
    """With other names, reversed axes and bent links, the closed form still applies and agrees with Pinocchio."""
    folder = broken_folder("urdf/guara.urdf", "<robot", "<robot")
    for path in [folder / "robot.toml", *folder.glob("*/guara.*")]:
        text = path.read_text(encoding="utf-8")
        for old, new in (("_haa_", "_a_"), ("_hfe_", "_b_"), ("_kfe_", "_c_"), ("_afe_", "_d_")):
            text = text.replace(old, new)
        path.write_text(text, encoding="utf-8")
    urdf = folder / "urdf" / "guara.urdf"
    text = urdf.read_text(encoding="utf-8")
    for leg in guara.legs:
        # The knee is 20 mm in front of the line of the thigh, and its axis points to the right.
        start = text.index(f'<joint name="{leg}_c_joint"')
        end = text.index("</joint>", start)
        block = text[start:end].replace('xyz="0 0 -0.150"', 'xyz="0.02 0 -0.150"')
        block = block.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>').replace(
            'lower="0" upper="2.2"', 'lower="-2.2" upper="0.5"'
        )
        text = text[:start] + block + text[end:]
    urdf.write_text(text, encoding="utf-8")
    srdf = folder / "srdf" / "guara.srdf"
    # The old postures no longer apply: both become the straight leg, with its heights.
    import re

    states = re.sub(r'(_[abcd]_joint" value=)"[^"]*"', r'\1"0"', srdf.read_text(encoding="utf-8"))
    srdf.write_text(re.sub(r'    <joint name="root_joint"[^>]*>\n', "", states), encoding="utf-8")
    toml = (folder / "robot.toml").read_text(encoding="utf-8")
    toml = re.sub(r"hip_height = [\d.]+", "hip_height = 0.400", toml)
    toml = re.sub(r"camera_height = [\d.]+", "camera_height = 0.540", toml)
    (folder / "robot.toml").write_text(toml, encoding="utf-8")
    robot = load_robot(folder)
    rng = np.random.default_rng(8)
    for leg in robot.legs:
        geometry = find_leg_geometry(robot.tree, leg)
        assert geometry is not None and geometry.senses.tolist() == [1.0, 1.0, -1.0, 1.0]
        for _ in range(20):
            positions = rng.uniform(geometry.lower, geometry.upper)
            joints = dict(zip(robot.joint_names, np.zeros(16), strict=True))
            joints.update(zip(robot.tree.leg(leg).joints, positions.tolist(), strict=True))
            sole = robot.state(joints).soles_in_base([leg])[0]
            np.testing.assert_allclose(geometry.soles_in_base(positions), sole, atol=1e-12)
            pitch = np.array([positions @ (0.0, 1.0, -1.0, 1.0)])
            found = geometry.solve(sole[None], pitch)[0]
            np.testing.assert_allclose(geometry.soles_in_base(found), sole, atol=1e-12)
    shutil.rmtree(tmp_path / "guara")


def test_numeric_solver_agrees_with_the_closed_form(guara: RobotModel) -> None:
    """On a grid of soles and pitches, the numeric solver finds the same joints, or none where there are none."""
    geometry = find_leg_geometry(guara.tree, "rh")
    assert geometry is not None
    x, y = np.meshgrid(np.linspace(-0.25, 0.25, 9), np.linspace(-0.2, 0.2, 7))
    soles = geometry.hip + np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -0.35)])
    pitch = np.linspace(-0.2, 0.2, len(soles))
    exact = geometry.solve(soles, pitch)
    exact[np.any((exact < geometry.lower) | (exact > geometry.upper), axis=1)] = np.nan
    numeric = NumericLeg(guara.tree, "rh", np.array([0.0, -0.5, 1.0, -0.5])).solve(soles, pitch)
    np.testing.assert_array_equal(np.isnan(numeric), np.isnan(exact))
    assert 10 < np.isfinite(exact[:, 0]).sum() < len(exact)
    np.testing.assert_allclose(numeric, exact, atol=1e-6)


def test_legs_of_three_joints_have_a_closed_form(tapir: RobotModel) -> None:
    """With a hip offset, the closed form agrees with Pinocchio and the numeric solver, also out of reach."""
    rng = np.random.default_rng(6)
    for leg in tapir.legs:
        geometry = find_leg_geometry(tapir.tree, leg)
        assert geometry is not None and abs(geometry.aside) > 0.01 and geometry.radius == 0.0
        names = tapir.tree.leg(leg).joints
        bends = rng.uniform(
            0.9 * geometry.lower + 0.1 * geometry.upper, 0.1 * geometry.lower + 0.9 * geometry.upper, (15, 3)
        )
        states = [tapir.state(tapir.posture("scan") | dict(zip(names, each.tolist(), strict=True))) for each in bends]
        soles = np.array([state.soles_in_base([leg])[0] for state in states])
        np.testing.assert_allclose(geometry.soles_in_base(bends), soles, atol=1e-12)
        knees, ends = geometry.shanks_in_base(bends)
        shank = tapir.tree.urdf.path_to(tapir.tree.leg(leg).sole)[2].child
        np.testing.assert_allclose(knees, [state.position_in_base(shank) for state in states], atol=1e-12)
        np.testing.assert_allclose(ends[:, 2], soles[:, 2], atol=1e-12)
        asked = np.concatenate((soles, soles + rng.uniform(-0.1, 0.1, soles.shape), np.full((1, 3), np.nan)))
        exact = geometry.solve(asked, np.zeros(len(asked)))
        np.testing.assert_allclose(geometry.soles_in_base(exact[:15]), soles, atol=1e-9)
        exact[~tapir.reachable(leg, asked)] = np.nan
        numeric = NumericLeg(tapir.tree, leg, 0.5 * (geometry.lower + geometry.upper)).solve(
            asked, np.zeros(len(asked))
        )
        both = np.isfinite(numeric[:, 0]) & np.isfinite(exact[:, 0])
        assert both.sum() > 10 and not np.isfinite(numeric[~np.isfinite(exact[:, 0]), 0]).any()
        np.testing.assert_allclose(geometry.soles_in_base(numeric[both]), asked[both], atol=1e-8)


def test_numeric_solver_places_a_point_foot(tapir: RobotModel) -> None:
    """Legs of three joints reach their targets to 1e-8 m by Pinocchio's forward kinematics, within limits."""
    rng = np.random.default_rng(6)
    for leg in tapir.legs:
        names = tapir.tree.leg(leg).joints
        columns = [tapir.tree.joint_index(name) for name in names]
        lower, upper = tapir.tree.lower_limits[columns], tapir.tree.upper_limits[columns]
        soles = []
        for positions in rng.uniform(0.9 * lower + 0.1 * upper, 0.1 * lower + 0.9 * upper, (15, 3)):
            joints = tapir.posture("scan") | dict(zip(names, positions.tolist(), strict=True))
            soles.append(tapir.state(joints).soles_in_base([leg])[0])
        found = NumericLeg(tapir.tree, leg, tapir.tree.nominal[columns]).solve(np.array(soles), np.zeros(len(soles)))
        assert np.isfinite(found[:, 0]).mean() > 0.9
        for sole, positions in zip(soles, found, strict=True):
            if np.isfinite(positions).all():
                joints = tapir.posture("scan") | dict(zip(names, positions.tolist(), strict=True))
                np.testing.assert_allclose(tapir.state(joints).soles_in_base([leg])[0], sole, atol=1e-8)
