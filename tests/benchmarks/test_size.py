"""Sizes of the project, counted by `benchmarks.size`."""

import json
import subprocess
import sys
from pathlib import Path

import click
import pytest

from benchmarks.size import code_lines, shown_commands, shown_options

TEXT = '''"""Docstring
of two lines."""

import ast
from pathlib import (
    Path,
)  # all of it is one import


# a comment
def function(x):  # a line of code
    """Docstring."""
    import json

    text = """a string
that is code"""
    return (
        x
    )
'''


def test_only_code_is_counted():
    """Blank lines, comments, docstrings and imports are no code; lines of a string that is no docstring are."""
    assert code_lines(TEXT) == len(["def function", "text = ", "that is code", "return (", "x", ")"])


def test_only_what_help_shows_is_counted():
    """Hidden commands and options, --help and --verbose are left out."""
    options = [click.Option(["--one"]), click.Option(["--two"], hidden=True), click.Option(["-v", "--verbose"])]
    inner = click.Group("inner", commands=[click.Command("a", params=options), click.Command("b", hidden=True)])
    group = click.Group("all", commands=[inner])
    shown = dict(shown_commands(group, click.Context(group, info_name="all")))
    assert set(shown) == {"all inner", "all inner a"}
    assert shown_options(shown["all inner a"]) == 1


@pytest.mark.slow
def test_sizes_end_with_one_line_of_json(root: Path):
    """Every figure is there, and a frame passes the files that every scan needs."""
    command = [sys.executable, "-m", "benchmarks.size", "--json"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    for part in ("product", "testbed", "tests", "benchmarks"):
        assert set(found[part]) == {"lines", "modules"}
    assert found["product"]["lines"] > found["product"]["modules"] > 100
    for name in ("docs_words", "commands", "options", "public_names"):
        assert found[name] > 10
    assert found["commands_at_top"] <= found["commands"] and found["options_of_run"] < found["options"]
    assert 10 < found["frame_to_bytes"]["files"] < found["frame_to_bytes"]["functions"]
