"""Examples called wrongly end in one line and exit code 2."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.forked import run_forked

EXAMPLES = Path(__file__).parents[2] / "examples"
WRONG = {
    "no argument": ("read_grid.py", [], "0 arguments given; usage: python {file} SCAN CALIBRATION"),
    "too many": ("plan_swing.py", ["a", "b"], "2 arguments given; usage: python {file} GRID"),
    "no such file": ("plot_layers.py", ["none.npz", "a.png"], "none.npz: no such file"),
    "no such robot": ("own_robot.py", ["nobody"], "no robot 'nobody'"),
    "no such folder": ("own_camera.py", ["nowhere"], "nowhere"),
    "Zenoh alone": ("plain_zenoh.py", ["a"], "1 arguments given; usage: python {file} ENDPOINT KEY FILE"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", WRONG)
def test_a_mistake_is_one_line_and_exit_2(case: str, tmp_path: Path) -> None:
    """What was given, and what the example takes."""
    name, arguments, expected_text = WRONG[case]
    file = str(EXAMPLES / name)
    done = run_forked(file, *arguments, folder=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert expected_text.format(file=file) in done.stderr and done.stderr.count("\n") == 1, done.stderr


def test_every_example_with_arguments_takes_them_the_same_way() -> None:
    """None unpacks the command line by itself, except the one that shows Zenoh alone."""
    for path in EXAMPLES.glob("*.py"):
        calls = [ast.unparse(node) for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
        assert not [call for call in calls if "*sys.argv" in call], path.name
