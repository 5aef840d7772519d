"""The 30 mistakes that were made on the first days of two strangers, and the tests that make each and see its message.

`python -m tests.guara_perception.app.test_beginners_mistakes` prints the table.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[2]
RECORD, REFUSALS = "guara_perception/app/record/test_record.py", "guara_perception/calibration/test_refusals.py"
PROCESS, DEVICES = "guara_perception/app/commands/test_process.py", "guara_perception/app/test_devices_file.py"
CROSSES = "guara_perception/calibration/test_crosses.py"
# Mistake, text of the message in the test, file, test.
MISTAKES = (
    ("plates in the wrong order", "exchange the heights in", RECORD, "a_refusal_tells_the_way_on"),
    (
        "plate 75 for 80 mm",
        "contradicts the others: they put",
        "guara_perception/calibration/test_calibrate.py",
        "wrong_plate_is_named",
    ),
    ("plate forgotten", "--redo plates", RECORD, "a_part_is_recorded_again"),
    (
        "camera upside down",
        "rolled by 180 degrees",
        "guara_perception/calibration/test_mirrored_pictures.py",
        "no_mirrored_grid_is_called_good",
    ),
    (
        "camera mirrored",
        "pictures are mirrored",
        "guara_perception/calibration/test_mirrored_pictures.py",
        "no_mirrored_grid_is_called_good",
    ),
    ("wrong square size", "--square", RECORD, "a_refusal_tells_the_way_on"),
    ("ruler of 15", "--printed-150 is 15 mm; allowed: 135 ... 165", RECORD, "wrong_options_are_refused"),
    ("plates in millimetres", "heights of -0.5 ... 0.5 m", RECORD, "wrong_options_are_refused"),
    ("--plates 0", "allowed: 2 ... 20 heights", RECORD, "wrong_options_are_refused"),
    ("another board", "wrong corner count", REFUSALS, "fault_is_refused"),
    (
        "one cross 10 mm off",
        "according to the others, cross",
        CROSSES,
        "the_one_cross_that_was_measured_wrongly_is_named",
    ),
    ("all crosses off", "near where the nominal mount predicts them", REFUSALS, "fault_is_refused"),
    (
        "one cross forgotten",
        "weak match",
        CROSSES,
        "a_forgotten_cross_is_named_and_no_cross_is_called_wrongly_measured",
    ),
    ("crosses in millimetres", "give metres, not", RECORD, "wrong_options_are_refused"),
    (
        "board not on the floor",
        "floor was not found",
        "guara_perception/app/record/test_live_pictures.py",
        "a_board_that_is_not_on_the_floor_is_asked_for_again_with_the_reason",
    ),
    (
        "lens cap",
        "no column of the image shows the laser",
        "drivers/sweep/test_metering.py",
        "no_stripe_at_all_is_an_error",
    ),
    ("blur", "blurred: black-white edges are", REFUSALS, "fault_is_refused"),
    (
        "too bright, recording",
        "shade the scene or close the iris",
        "guara_perception/app/record/test_board_advice.py",
        "a_picture_that_is_clipped_says_what_to_do",
    ),
    (
        "too bright, scanning",
        "is clipped without the laser: shade the scen",
        "guara_perception/scanning/test_light_diagnosis.py",
        "health_names_the_effect_of_light_and_what_to_change",
    ),
    (
        "dark, scanning",
        "no stripe shows the laser",
        "drivers/sweep/test_acquisition_faults.py",
        "dead_laser_behind_a_blind_sensor_shows_in_the_pictures",
    ),
    ("frame deleted", "which does not exist", PROCESS, "keep_going_goes_on_without_a_missing_frame"),
    (
        "no permission on USB",
        "udevadm control --reload-rules",
        "drivers/board/test_udev.py",
        "instructions_install_the_rule_and_load_it",
    ),
    (
        "board held by another program",
        "another program uses",
        "drivers/board/test_usb_link.py",
        "second_program_finds_the_board_in_use",
    ),
    (
        "no board",
        "no laser board",
        "guara_perception/app/commands/test_scan_and_run.py",
        "without_a_board_a_scan_fails_and_says_so",
    ),
    ("no camera", "no camera found: check cable", "guara_perception/app/test_find_cameras.py", "no_camera_at_all"),
    (
        "name of the robot misspelt",
        "no robot 'tapir'",
        "guara_perception/app/commands/test_process_refusals.py",
        "bad_scan_is_refused",
    ),
    (
        "new robot, not measured",
        "not needed with --simulated",
        "guara_perception/app/commands/test_scan_and_run.py",
        "a_real_robot_does_not_walk_on_assumed_values",
    ),
    (
        "calibration of another rig",
        "the calibration belongs to another camera or mount",
        "guara_perception/app/test_doctor.py",
        "drift_is_checked_on_a_scan",
    ),
    (
        "devices.toml: key misspelt, text without quotes",
        "text needs quotes",
        DEVICES,
        "wrong_files_are_refused_by_field",
    ),
    (
        "wrong name in `guara listen`",
        "no node of robot 'tapir' was found",
        "guara_perception/app/test_client.py",
        "other_robots_node_is_not_taken_for_ours",
    ),
)


@pytest.mark.parametrize(("mistake", "said", "file", "name"), MISTAKES, ids=[each[0] for each in MISTAKES])
def test_a_test_makes_the_mistake_and_sees_the_message(mistake: str, said: str, file: str, name: str):
    """The test exists; the message is in it, or in a list of cases that it uses."""
    body = ast.parse((TESTS / file).read_text()).body
    (test,) = (node for node in body if isinstance(node, ast.FunctionDef) and node.name == f"test_{name}")
    used = {node.id for node in ast.walk(test) if isinstance(node, ast.Name)}
    lists = [node for node in body if isinstance(node, ast.Assign | ast.AnnAssign) and used & _names(node)]
    texts = [node.value for part in (test, *lists) for node in ast.walk(part) if isinstance(node, ast.Constant)]
    assert any(said in text for text in texts if isinstance(text, str))


def _names(node: ast.Assign | ast.AnnAssign) -> set[str]:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    return {target.id for target in targets if isinstance(target, ast.Name)}


def test_all_thirty_are_there():
    """No mistake is listed twice."""
    assert len({mistake for mistake, *_ in MISTAKES}) == 30


if __name__ == "__main__":
    for mistake, said, file, name in MISTAKES:
        print(f"{mistake:<50} {said:<55} {file}::test_{name}")
