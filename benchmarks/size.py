"""Sizes of the project: code lines, modules, words, commands, options, names, and the way of a frame to bytes.

`python -m benchmarks.size [--json]`. A code line is a line of a .py file that holds a token besides comments,
docstrings and import statements; blank lines hold none. C is not counted. Commands and options are those that `--help`
shows: commands without subcommands, and options besides --help and --verbose, which every command has. A frame passes
the files of the product whose functions run when one recorded scan is added to a ScanProcessor, finished and encoded.
"""

from __future__ import annotations

import ast
import inspect
import io
import json
import sys
import threading
import tokenize
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import click

import guara_perception as gp
from benchmarks.command import options
from guara_perception.app.main import guara
from guara_perception.app.messages import terrain_to_message
from guara_perception.scan import frame_reader
from testbed.truth import truth_calibration
from transport import encode_terrain

ROOT = Path(__file__).resolve().parents[1]
PRODUCT = ("guara_perception", "kinematics", "transport", "drivers")
PARTS = {"product": PRODUCT, "testbed": ("testbed",), "tests": ("tests",), "benchmarks": ("benchmarks",)}
LAYOUT = {tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.COMMENT, tokenize.ENDMARKER}
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
EVERYWHERE = {"help", "verbose"}


def code_lines(text: str) -> int:
    """Number of lines without blanks, comments, docstrings and imports."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    lines = {line for token in tokens if token.type not in LAYOUT for line in range(token.start[0], token.end[0] + 1)}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            lines.difference_update(range(node.lineno, (node.end_lineno or 0) + 1))
        elif isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            lines.difference_update(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    return len(lines)


def part_size(folders: tuple[str, ...]) -> dict[str, int]:
    """Code lines and modules of all .py files below these folders."""
    files = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    return {"lines": sum(code_lines(path.read_text()) for path in files), "modules": len(files)}


def docs_words() -> int:
    """Number of words of README.md and the pages of docs."""
    return sum(len(page.read_text().split()) for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")))


def shown_commands(group: click.Group, context: click.Context) -> Iterator[tuple[str, click.Command]]:
    """Path and command of every command below a group that its help shows, groups included."""
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if command is None or command.hidden:
            continue
        inner = click.Context(command, parent=context, info_name=name)
        yield inner.command_path, command
        if isinstance(command, click.Group):
            yield from shown_commands(command, inner)


def shown_options(command: click.Command) -> int:
    """Number of options that the help of a command shows, besides those of every command."""
    options = [each for each in command.params if isinstance(each, click.Option) and not each.hidden]
    return sum(option.name not in EVERYWHERE for option in options)


def passed_functions() -> list[tuple[Path, str, int]]:
    """File, name and first line of the product's functions that a scan calls from frames to bytes, by first call."""
    data = ROOT / "tests" / "data"
    scan = gp.open_scan(data / "scans" / "paper")
    robot = gp.load_robot(scan.robot)
    processor = gp.ScanProcessor(truth_calibration(data), robot, scan.stance, scan.mode, stamp=scan.end)
    frames = list(map(frame_reader(scan), scan.stripes))
    called: dict[CodeType, None] = {}

    def note(frame: FrameType, event: str, argument: Any) -> None:
        if event == "call":
            called[frame.f_code] = None

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        for frame in frames:
            processor.add(frame.index, frame.on, frame.off)
        encode_terrain(terrain_to_message(processor.finish(), robot=robot.name, sequence=1))
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    # Bodies of modules and classes run at a first import, and comprehensions are functions in some versions of Python.
    return list(
        dict.fromkeys(
            (Path(code.co_filename).relative_to(ROOT), code.co_qualname, code.co_firstlineno)
            for code in called
            if code.co_flags & inspect.CO_OPTIMIZED
            and not code.co_name.endswith(("comp>", "genexpr>"))
            and any(Path(code.co_filename).is_relative_to(ROOT / package) for package in PRODUCT)
        )
    )


def frame_to_bytes() -> dict[str, int]:
    """Number of files and functions of the product from `ScanProcessor.add` to the bytes of the grid's message."""
    functions = passed_functions()
    return {"files": len({file for file, _, _ in functions}), "functions": len(functions)}


def sizes() -> dict[str, Any]:
    """All figures by name."""
    commands = dict(shown_commands(guara, click.Context(guara, info_name="guara")))
    leaves = {path: command for path, command in commands.items() if not isinstance(command, click.Group)}
    return {
        **{name: part_size(folders) for name, folders in PARTS.items()},
        "docs_words": docs_words(),
        "commands": len(leaves),
        "commands_at_top": sum(path.count(" ") == 1 for path in commands),
        "options": sum(map(shown_options, leaves.values())),
        "options_of_run": shown_options(commands["guara run"]),
        "public_names": len(vars(gp)["__all__"]),
        "frame_to_bytes": frame_to_bytes(),
    }


def main() -> None:
    """Command line."""
    asked = options(__doc__, json=(False, "end with one line of JSON"))
    found = sizes()
    for name, value in found.items():
        shown = ", ".join(f"{each:,} {key}" for key, each in value.items()) if isinstance(value, dict) else f"{value:,}"
        print(f"{name.replace('_', ' '):16} {shown}")
    if asked.json:
        print(json.dumps(found))


if __name__ == "__main__":
    main()
