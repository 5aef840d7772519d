from collections.abc import Callable
from pathlib import Path

import pytest

from kinematics import KinematicsError, RobotFileError, RobotModel, load_robot

FAULTS = {
    "table missing": ("[stance]", "[stanze]", "the table [stance] is missing"),
    "frames missing": ("[frames]", "[frame]", "the table [frames] is missing"),
    "key missing": ("encoder_sigma", "encoder", "[stance] encoder_sigma is missing"),
    "text for number": (
        "encoder_sigma = 0.0035",
        'encoder_sigma = "x"',
        "[stance] encoder_sigma is 'x'; a number above 0",
    ),
    "negative": ("encoder_sigma = 0.0035", "encoder_sigma = -1.0", "encoder_sigma is -1.0; a number above 0 is needed"),
    "NaN": ("encoder_sigma = 0.0035", "encoder_sigma = nan", "encoder_sigma is nan; a number above 0 is needed"),
    "truth value": (
        "encoder_sigma = 0.0035",
        "encoder_sigma = true",
        "encoder_sigma is True; a number above 0 is needed",
    ),
    "sole of three": (
        "sole = [0.080, 0.060]",
        "sole = [0.080, 0.060, 1.0]",
        "sole is [0.08, 0.06, 1.0]; a list of two",
    ),
    "sole of nothing": ("sole = [0.080, 0.060]", "sole = [0.080, 0]", "a list of two numbers above 0 is needed"),
    "unknown frame": (
        'camera = "camera_optical_frame"',
        'camera = "eye"',
        "frames.camera is 'eye', which is not a link of guara.urdf",
    ),
    "unknown sole": (
        'sole = "lf_sole"',
        'sole = "lf_paw"',
        "legs.lf.sole is 'lf_paw', which is not a link of guara.urdf; its links are",
    ),
    "unknown joint": (
        '["lf_haa_joint",',
        '["lf_hip_joint",',
        "[legs.lf] joints contains 'lf_hip_joint', which is not a moving joint",
    ),
    "joint of two legs": (
        '["rf_haa_joint",',
        '["lf_haa_joint",',
        "joint 'lf_haa_joint' is listed in [legs.lf] and [legs.rf]",
    ),
    "joints out of order": (
        '["lf_haa_joint", "lf_hfe_joint"',
        '["lf_hfe_joint", "lf_haa_joint"',
        "the chain to 'lf_sole' in the URDF is lf_haa_joint, lf_hfe_joint",
    ),
    "hip of another leg": (
        'hip = "lf_hip_link"',
        'hip = "rf_hip_link"',
        "hip 'rf_hip_link' is not in the chain to 'lf_sole'",
    ),
    "no joints": (
        'joints = ["lf_haa_joint", "lf_hfe_joint", "lf_kfe_joint", "lf_afe_joint"]',
        "joints = []",
        "[legs.lf] joints is []",
    ),
    "joint twice": ('"lf_kfe_joint", "lf_afe_joint"', '"lf_kfe_joint", "lf_kfe_joint"', "a list of different names"),
    "text for list": (
        '["lf_haa_joint", "lf_hfe_joint", "lf_kfe_joint", "lf_afe_joint"]',
        '"lf_haa_joint"',
        "a list of non-empty strings is needed",
    ),
    "scan posture unknown": (
        'scan_posture = "scan"',
        'scan_posture = "sit"',
        "scan_posture is 'sit'; the name of a table [postures",
    ),
    "posture without angles": (
        "[postures.standing]",
        "[postures.lying]",
        "[postures.lying]: the SRDF has no such group_state",
    ),
    "hip height": (
        "hip_height = 0.360",
        "hip_height = 0.350",
        "[postures.scan]: hip_height of 'lf' is 0.3600 m in the posture, but 0.3500 m",
    ),
    "camera height": (
        "camera_height = 0.500",
        "camera_height = 0.600",
        "camera_height is 0.5000 m in the posture, but 0.6000 m is stated",
    ),
    "base is no root": ('base = "base_link"', 'base = "imu_link"', "robot.toml names 'imu_link' as frames.base"),
    "no TOML": ("[frames]", "[frames", "cannot be read as TOML"),
    "name empty": ('name = "guara"', 'name = ""', "name is ''; a non-empty string is needed"),
    "feet half": (
        "minimum_feet = 3",
        "minimum_feet = 2.5",
        "[pause] minimum_feet is 2.5; a whole number of at least 1",
    ),
    "slip": ("slip_sigmas = 4.5", "slip_sigmas = 0", "[odometry] slip_sigmas is 0; a number above 0 is needed"),
    "more digits than a float has": (
        "slip_sigmas = 4.5",
        f"slip_sigmas = 1{400 * '0'}",
        "000; a number above 0 is needed",
    ),
    "margin": ("margin = 0.010", "margin = -0.010", "[self_filter] margin is -0.01; a number of 0 or more is needed"),
    "ignored link": ("ignore = []", 'ignore = ["mast"]', "a list of links ('mast' is not a link; allowed: base_link"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_refused_by_name(fault: str, broken_folder: Callable[..., Path]) -> None:
    """A robot.toml with one fault is rejected when the robot is loaded; the message names table and key."""
    old, new, message = FAULTS[fault]
    with pytest.raises(RobotFileError) as caught:
        load_robot(broken_folder("robot.toml", old, new))
    assert message in str(caught.value)
    assert isinstance(caught.value, KinematicsError) and isinstance(caught.value, ValueError)


def test_two_legs_are_refused(broken_folder: Callable[..., Path], guara: RobotModel) -> None:
    """A robot of two legs has no support plane and is rejected."""
    text = (guara.folder / "robot.toml").read_text(encoding="utf-8")
    hind = text[text.index("[legs.lh]") : text.index("# Heights over")]
    with pytest.raises(RobotFileError, match="tables .* 2 given; a support plane needs three legs"):
        load_robot(broken_folder("robot.toml", hind, ""))


def test_tables_for_readers_above_are_there(robot: RobotModel) -> None:
    """Every robot states its grid, height limits, scan pattern, limits and validity."""
    for name in ("grid", "heights", "scan", "traversability", "validity"):
        assert len(robot.config.root.table(name).values) > 0
    scan = robot.config.root.table("scan").values
    assert scan["mirror_angle_first"] < scan["mirror_angle_last"]  # type: ignore[operator]


def test_missing_table_is_named_with_its_file(guara: RobotModel) -> None:
    """A request for a missing table names the file and the table."""
    with pytest.raises(RobotFileError, match=r"robot.toml: the table \[gait\] is missing"):
        guara.config.root.table("gait")


def test_a_value_is_no_table(guara: RobotModel) -> None:
    """A request for a single value as a table is rejected."""
    with pytest.raises(RobotFileError, match=r"name is 'guara'; a table \[name\] is needed"):
        guara.config.root.table("name")
