"""Command line: help with examples, exit codes, one line for a user's mistake and no traceback."""

import errno
import math
import subprocess
import sys
import warnings
from pathlib import Path

import click
import pytest

import guara_perception as gp
from guara_perception.app import main as module
from guara_perception.app.main import ALIASES, COMMANDS, LazyGroup, is_bad_input, run, text_of
from kinematics.exceptions import unknown_name
from tests.forked import run_forked
from transport import ConnectionFailed, ScanFailed, StaleTerrain

PROMISED = """
calibrate convert demo doctor export info listen process record recover replay run scan security targets view
""".split()


def with_subcommands(name: str) -> list[tuple[str, ...]]:
    """Command and, if it is a group, its subcommands."""
    command = module.guara.get_command(click.Context(module.guara), name)
    inner = sorted(command.commands) if isinstance(command, click.Group) else []
    return [(name,), *((name, word) for word in inner)]


@pytest.mark.parametrize("name", PROMISED)
def test_promised_command_is_there(name: str):
    """Every command of earlier versions exists, some as an alias of another."""
    assert name in COMMANDS or name in ALIASES


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_an_example(guara, name: str):
    """`--help` of each command and subcommand has an example that begins as a user would type it."""
    for arguments in with_subcommands(name):
        said = guara(*arguments, "--help")
        assert said.code == 0 and said.err == ""
        assert "Example:" in said.out
        example = said.out.split("Example:")[1].strip().splitlines()[0]
        assert example.startswith(f"guara {' '.join(arguments)}")
        assert "\\b" not in said.out and not [c for c in said.out if ord(c) < 32 and c != "\n"]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_says_what_it_does(name: str):
    """No option shows only its choices."""
    command = module.guara.get_command(click.Context(module.guara), name)
    commands = [command, *getattr(command, "commands", {}).values()]
    silent = [
        option.opts
        for each in commands
        for option in each.params
        if isinstance(option, click.Option) and not option.help
    ]
    assert not silent


@pytest.mark.parametrize("name", COMMANDS)
def test_each_example_stands_on_a_line_of_its_own(guara, name: str):
    """Each line of the example block is one complete command; none is wrapped or joined."""
    for arguments in with_subcommands(name):
        block = guara(*arguments, "--help").out.split("Example:\n")[1].split("\n\n")[0]
        assert all(line.startswith("    guara ") and line.count("guara ") == 1 for line in block.splitlines()), block


def test_help_lists_every_command(guara):
    """`guara --help` lists each command with a line that fits 80 columns, and no earlier spelling."""
    said = guara("--help")
    assert said.code == 0
    for name, line in COMMANDS.items():
        assert f"\n  {name.ljust(10)}  {line}\n" in said.out
    assert max(map(len, said.out.splitlines())) <= 80
    assert not any(f"\n  {name} " in said.out for name in ALIASES)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_group_shows_whole_lines(guara, name: str):
    """The line of each subcommand fits 80 columns."""
    for arguments in with_subcommands(name):
        _, *listed = guara(*arguments, "--help").out.split("\nCommands:\n")
        assert "...\n" not in "".join(listed)


@pytest.mark.parametrize("name", ALIASES)
def test_an_earlier_spelling_of_a_command_still_works(guara, name: str):
    """Its help names the new spelling, which is a listed command."""
    said = guara(name, "--help")
    assert said.code == 0 and f"guara {ALIASES[name]} " in said.out


@pytest.mark.parametrize(
    ("arguments", "new"),
    [(["fleet", "--timeout", "0.1"], "guara listen --all"), (["view", "x", "--instance", "a"], "--name")],
)
def test_an_earlier_spelling_tells_the_new_one(guara, arguments: list[str], new: str):
    """In one line on standard error, before the output of the command itself."""
    assert (
        guara(*arguments).err.splitlines()[0].endswith(f"is now {new}; the old spelling works until the next release")
    )


def test_no_command_at_all_shows_the_help_and_is_bad_usage(guara):
    """Without arguments, the help is printed to standard error and the exit code is 2."""
    said = guara()
    assert said.code == 2 and said.out == ""
    assert said.err.startswith("Usage: guara") and "\n  process " in said.err


@pytest.mark.parametrize(
    ("arguments", "reported"),
    [
        (["proces"], "no command 'proces'; allowed: demo, doctor, "),
        (["security", "remove"], "No such command 'remove'. Did you mean 'revoke'? (see guara security --help)"),
        (["process"], "Missing argument 'SCAN' (see guara process --help)"),
        (["process", "x"], "Missing option '-o' / '--out'"),
        (["process", "x", "-o", "y.npz"], "x: no such scan"),
        (["process", "x", "-c", "c.json", "-o", "y.npz", "--resolution", "fine"], "'fine' is not a valid float"),
        (["listen", "--extent", "world"], "'world' is not one of 'footprint', 'map'"),
        (["demo", "--out", __file__], "is a file; a folder is needed"),
        (["listen", "--count", "0"], "0 is not in the range x>=1"),
        (["--nonsense"], "No such option"),
    ],
)
def test_bad_usage_is_one_line_and_exit_2(guara, arguments: list[str], reported: str):
    """Usage errors are reported in one line that starts with the program's name."""
    said = guara(*arguments)
    assert said.code == 2 and said.out == ""
    assert reported in said.err and said.err.startswith("guara: ") and said.err.count("\n") == 1


def fail_with(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    """Make the command `process` raise an error."""

    def callback() -> None:
        raise error

    monkeypatch.setattr(LazyGroup, "get_command", lambda *_: click.Command("process", callback=callback))


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (gp.InvalidInput("x is 3, allowed: 1, 2"), 2),
        (gp.MissingFile("a.json: no such file"), 2),
        (gp.FileFormatError("a.json: field"), 2),
        (gp.CalibrationMismatch("not this robot's"), 2),
        (unknown_name("leg", "xx", ["lf", "rf"]), 2),
        (PermissionError(errno.EACCES, "Permission denied", "/x"), 2),
        (NotADirectoryError(errno.ENOTDIR, "Not a directory", "/x/y"), 2),
        (gp.CalibrationRefused("too few boards"), 1),
        (gp.UnsafeGrid("a cell is traversable with a hazard"), 1),
        (StaleTerrain("newest grid is 9 s old"), 1),
        (ConnectionFailed("nobody listens"), 1),
        (ScanFailed("the mirror did not move"), 1),
        (OSError(errno.ENOSPC, "No space left on device"), 1),
        (ImportError("libgomp.so.1: cannot open shared object file: No such file or directory"), 1),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else str(value),
)
def test_errors_become_exit_codes(guara, monkeypatch: pytest.MonkeyPatch, error: Exception, code: int):
    """Errors that the user can correct exit 2, failures at run time 1; the message is one line on standard error."""
    fail_with(monkeypatch, error)
    said = guara("process")
    assert said.code == code and said.out == ""
    assert said.err == f"guara: {text_of(error)}\n"
    assert is_bad_input(error) == (code == 2)


@pytest.mark.parametrize(
    ("error", "expected_text"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "/x/t.npz"), "/x/t.npz: No space left on device"),
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device"),
        (FileNotFoundError("gone"), "gone"),
        (gp.MissingFile("a.json: no such file"), "a.json: no such file"),
        (ImportError("libgomp.so.1: cannot open"), "libgomp.so.1: cannot open (Debian: apt install libgomp1)"),
    ],
)
def test_errors_of_the_file_system_begin_with_the_file(error: Exception, expected_text: str):
    """Like the package's own messages, and without the error number of the system."""
    assert text_of(error) == expected_text


def test_a_full_disk_is_no_bad_input_whoever_reports_it():
    """An error of the package that was caused by a full disk exits 1."""
    for cause, is_bad in ((OSError(errno.ENOSPC, "full"), False), (OSError(errno.EACCES, "not allowed"), True)):
        error = gp.InvalidInput("cannot write x")
        error.__cause__ = cause
        assert is_bad_input(error) is is_bad


def test_message_of_several_lines_becomes_one(guara, monkeypatch: pytest.MonkeyPatch):
    """A script reads one line, whatever the message contains."""
    fail_with(monkeypatch, gp.InvalidInput("first\n   second"))
    assert guara("process").err == "guara: first second\n"


def test_a_file_name_of_thousands_of_characters_is_not_printed_whole(guara, tmp_path: Path):
    said = guara("info", tmp_path / ("x" * 5000))
    assert said.code in (1, 2)
    assert "xxx...xxx" in said.err and len(said.err) < 500


def test_defects_are_not_hidden(monkeypatch: pytest.MonkeyPatch):
    """An unexpected error is a defect and shows its traceback."""
    fail_with(monkeypatch, KeyError("inside"))
    with pytest.raises(KeyError, match="inside"):
        run(["process"])


@pytest.mark.parametrize("error", [KeyboardInterrupt(), click.Abort()])
def test_interruption_is_clean(guara, monkeypatch: pytest.MonkeyPatch, error: BaseException):
    """Ctrl-C prints one word and exits with the shell's code for it."""
    fail_with(monkeypatch, error)
    said = guara("process")
    assert (said.code, said.out, said.err.strip()) == (130, "", "guara: stopped")


@pytest.mark.parametrize("code", [0, 1, 2])
def test_exit_code_that_a_command_asks_for_is_given(guara, monkeypatch: pytest.MonkeyPatch, code: int):
    """The code of `ctx.exit(code)`, for instance of a refused calibration, is passed to the shell."""

    @click.command()
    @click.pass_context
    def command(ctx: click.Context) -> None:
        ctx.exit(code)

    monkeypatch.setattr(LazyGroup, "get_command", lambda *_: command)
    assert guara("process").code == code


def shell(*arguments: str | Path) -> subprocess.CompletedProcess:
    """The command in its own process, as a user starts it."""
    return subprocess.run(
        [sys.executable, "-m", "guara_perception.app.main", *map(str, arguments)], capture_output=True, text=True
    )


def test_version_is_that_of_the_package():
    """`guara --version` prints the program and its version."""
    done = shell("--version")
    assert done.returncode == 0 and done.stdout.startswith("guara, version 0.")


@pytest.mark.slow
def test_mistake_in_a_real_shell_shows_no_traceback(tmp_path: Path):
    """From outside: exit 2, one line, nothing on standard output, no file."""
    done = shell("process", tmp_path / "none", "-c", tmp_path / "c.json", "-o", tmp_path / "o.npz")
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr == f"guara: {tmp_path / 'none'}: no such scan\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_reader_that_goes_away_is_no_traceback():
    """`guara --help | head -1`: the pipe is closed early without an error message."""
    process = subprocess.Popen(
        [sys.executable, "-m", "guara_perception.app.main", "--help"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    process.stdout.close()
    errors = process.stderr.read()
    process.stderr.close()
    assert process.wait(60) == 1 and errors == ""


@pytest.mark.parametrize("name", COMMANDS)
def test_verbose_may_stand_behind_every_command(name: str):
    """`guara run -v` is the same as `guara -v run`."""
    for arguments in with_subcommands(name):
        command = module.guara.get_command(click.Context(module.guara), arguments[0])
        for word in arguments[1:]:
            command = command.commands[word]
        assert [o for o in command.params if o.name == "verbose"], arguments


@pytest.mark.slow
def test_verbose_behind_the_command_shows_the_log(data: Path, tmp_path: Path):
    """The log level changes in either position of the switch."""
    code = (
        "import logging, sys; from guara_perception.app.main import run; run(sys.argv[1:]); print(logging.root.level)"
    )
    for arguments, level in (
        (["info", str(data), "-v"], "20"),
        (["info", str(data)], "30"),
        (["-v", "info", "x"], "20"),
    ):
        done = run_forked("-c", code, *arguments)
        assert done.returncode == 0, done.stderr
        assert done.stdout.splitlines()[-1] == level


def test_warnings_are_reported_in_words_and_once(guara, monkeypatch: pytest.MonkeyPatch):
    """Each Python warning becomes one line of the program; one that differs only in numbers is not repeated."""

    def callback() -> None:
        for angle in (0.7, 0.8):
            warnings.warn(f"joint lf_haa_joint is at {angle} rad", UserWarning, stacklevel=1)
        warnings.warn("joint rf_haa_joint is\n at 0.7 rad", UserWarning, stacklevel=1)

    monkeypatch.setattr(LazyGroup, "get_command", lambda *_: click.Command("process", callback=callback))
    said = guara("process")
    assert said.code == 0
    assert said.err.splitlines() == [
        "guara: warning: joint lf_haa_joint is at 0.7 rad",
        "guara: warning: joint rf_haa_joint is at 0.7 rad",
    ]


def test_joints_in_degrees_are_bad_input(guara, tmp_path: Path, edited_scan, calibration_file: Path):
    """A stance in degrees: one line, exit 2, no grid."""

    def in_degrees(content: dict) -> None:
        joints = content["stance"]["joint_positions"]
        content["stance"]["joint_positions"] = {name: math.degrees(value) for name, value in joints.items()}

    said = guara("process", edited_scan(in_degrees), "-c", calibration_file, "-o", tmp_path / "t.npz")
    assert said.code == 2 and said.err.count("\n") == 1 and not (tmp_path / "t.npz").exists()
    assert "half a turn or more beyond its limits" in said.err and "positions are in radians" in said.err


@pytest.mark.slow
def test_joints_beyond_their_limits_are_one_line(guara, tmp_path: Path, edited_scan, calibration_file: Path):
    """Every hip exceeds its limit: a grid is made, and one line names three joints and counts the others."""

    def beyond(content: dict) -> None:
        for name in content["stance"]["joint_positions"]:
            if name.endswith("haa_joint"):
                content["stance"]["joint_positions"][name] = 0.61 if name[0] == "l" else -0.61

    said = guara("process", edited_scan(beyond), "-c", calibration_file, "-o", tmp_path / "t.npz")
    warned = [line for line in said.err.splitlines() if line.startswith("guara: warning: ")]
    assert said.code == 0 and len(warned) == 1 and warned[0].endswith("; and 1 more joint"), said.err
