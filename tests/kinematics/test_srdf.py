from collections.abc import Callable
from pathlib import Path

import pytest

from kinematics import RobotFileError, RobotModel, load_robot

FAULTS = {
    "unknown joint": (
        '"lf_haa_joint" value="0"',
        '"lf_hip" value="0"',
        "group_state 'standing': unknown joint 'lf_hip'; guara.urdf has",
    ),
    "joint missing": (
        '<joint name="lf_haa_joint" value="0"/>',
        "",
        "group_state 'standing': no value for lf_haa_joint",
    ),
    "joint twice": (
        '"rf_haa_joint" value="0"',
        '"lf_haa_joint" value="0"',
        "joint 'lf_haa_joint' must be given once, with one value",
    ),
    "no number": (
        '"lf_haa_joint" value="0"',
        '"lf_haa_joint" value="zero"',
        "value 'zero' is not a list of finite numbers",
    ),
    "NaN": ('"lf_haa_joint" value="0"', '"lf_haa_joint" value="nan"', "value 'nan' is not a list of finite numbers"),
    "short root": ('value="0 0 0.36 0 0 0 1"', 'value="0 0 0.36"', "root_joint has 3 numbers; seven are needed"),
    "root twice": (
        '<joint name="root_joint" value="0 0 0.36 0 0 0 1"/>',
        2 * '<joint name="root_joint" value="0 0 0.36 0 0 0 1"/>',
        "root_joint is given twice",
    ),
    "root at another height": (
        'value="0 0 0.36 0 0 0 1"',
        'value="0 0 0.4 0 0 0 1"',
        "root_joint z of the SRDF is 0.3600 m in the posture, but 0.4000 m is stated",
    ),
    "unknown link": (
        'link2="lf_hip_link"',
        'link2="lf_hip"',
        "<disable_collisions>: link2 'lf_hip' is not a link of guara.urdf",
    ),
    "posture twice": (
        'group_state name="scan"',
        'group_state name="standing"',
        "group_state 'standing' is defined 2 times",
    ),
    "a foot off the floor": ('"lf_hfe_joint" value="-0.39', '"lf_hfe_joint" value="-0.49', "the sole of 'lf' is"),
    "beyond limits": (
        '"lf_haa_joint" value="0"',
        '"lf_haa_joint" value="0.7"',
        "joint 'lf_haa_joint' is at 0.7, outside its limits",
    ),
    "no XML": ("</robot>", "", "is not valid XML"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_refused_by_name(fault: str, broken_folder: Callable[..., Path]) -> None:
    """An SRDF with one fault, which Pinocchio may accept, is rejected with a message that names its element."""
    old, new, message = FAULTS[fault]
    with pytest.raises(RobotFileError) as caught:
        load_robot(broken_folder("srdf/guara.srdf", old, new))
    assert message in str(caught.value)


def test_missing_srdf_is_named(broken_folder: Callable[..., Path]) -> None:
    """A robot folder without its SRDF is rejected; the message names the file."""
    folder = broken_folder("srdf/guara.srdf", "<robot", "<robot")
    (folder / "srdf" / "guara.srdf").unlink()
    with pytest.raises(RobotFileError, match="guara.srdf: cannot be read"):
        load_robot(folder)


def test_pinocchio_reads_the_same_postures(guara: RobotModel) -> None:
    """Pinocchio's own SRDF reader gives the same joint positions."""
    import pinocchio

    model = guara.tree.pinocchio_model.copy()
    pinocchio.loadReferenceConfigurations(model, str(guara.folder / "srdf" / "guara.srdf"), False)
    for name in guara.posture_names:
        configuration = model.referenceConfigurations[name]
        for joint, value in guara.posture(name).items():
            assert configuration[model.joints[model.getJointId(joint)].idx_q] == value
