"""Command line `guara`: subcommands, imported when called, and the exit codes of errors."""

from __future__ import annotations

import errno
import importlib
import logging
import os
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import click

from guara_perception.app.exit_codes import EXIT_BAD_INPUT, EXIT_CALIBRATION, EXIT_FAILED, EXIT_INTERRUPTED
from guara_perception.app.logs import log_to_stderr

# Commands by group, with the line of each in `guara --help`; each is a module of guara_perception.app.commands.
GROUPS = {
    "Try": {
        "demo": "Walk a simulated robot over mixed terrain and pick footholds",
        "doctor": "Check camera, board, network and calibration of this machine",
    },
    "Calibrate": {
        "targets": "Draw board, crosses and labels to scale in a PDF",
        "record": "Record the pictures of a calibration session, step by step",
        "calibrate": "Compute a calibration from a recorded session",
    },
    "Run": {
        "run": "Start the node: scan at each stance pause and publish",
        "scan": "Scan once and keep the frames",
        "listen": "Print the grids of a node, or list the robots that are running",
        "view": "Show a walk in a browser, live or from a file",
    },
    "Files": {
        "import": "Import pictures taken by another program as a scan or session",
        "process": "Compute the terrain of a recorded scan",
        "replay": "Replay recorded scans of a walk, with fusion over pauses",
        "convert": "Convert, export or repair a recording, scan or grid",
        "info": "Describe a file or folder",
    },
    "Robots and sites": {
        "robot": "Create, check and test a robot; install its node as a service",
        "security": "Create and check certificates and access rules",
    },
}
COMMANDS = {name: line for group in GROUPS.values() for name, line in group.items()}
# Modules of commands whose names are reserved words in Python.
MODULES = {"import": "import_"}
# Earlier commands that are still accepted, and the command that each is now part of.
ALIASES = {
    "export": "convert",
    "recover": "convert",
    "acceptance": "robot",
    "service": "robot",
}
# Earlier commands that are still accepted, and their replacements.
EARLIER = {"cameras": ["doctor", "--cameras"], "fleet": ["listen", "--all"]}
CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100, "show_default": True}
# Variables set before numpy and OpenCV are loaded. Matrices are small, so linear algebra threads would only spin, which
# costs a quarter of the processor time of a scan. OpenCV's own warnings would repeat our errors.
ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OPENCV_LOG_LEVEL": "ERROR"}
# Number in the text of a warning; warnings that differ only in numbers are printed once.
NUMBER = re.compile(r"(?<=\s)-?\d+(\.\d+)?")
# Longest word of an error message that is not shortened [characters].
LONGEST_WORD = 300
# Errors of a full or broken disk, which are failures at run time and not bad input.
DISK_FAILED = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
LOG_HELP = "Log progress to standard error."


class LazyGroup(click.Group):
    """Command group that imports a command only when it is called or its help is shown."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands, in the order of the groups."""
        return list(COMMANDS)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands by group, one line each."""
        for group, commands in GROUPS.items():
            with formatter.section(group):
                formatter.write_dl([(name.ljust(10), line) for name, line in commands.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command by its current or an earlier name."""
        if args[0] in EARLIER:
            from guara_perception.app.options import note_new_spelling

            new = EARLIER[args[0]]
            note_new_spelling(f"guara {args[0]}", f"guara {' '.join(new)}")
            args = [*new, *args[1:]]
        return super().resolve_command(ctx, args)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; return None for an option, which click then reports.

        Raises:
            click.UsageError: no command has this name.
        """
        if cmd_name not in COMMANDS and cmd_name not in ALIASES:
            if cmd_name.startswith("-"):
                return None
            raise click.UsageError(f"no command {cmd_name!r}; allowed: {', '.join(COMMANDS)}")
        named = {**ALIASES, **MODULES}
        module = importlib.import_module(f"guara_perception.app.commands.{named.get(cmd_name, cmd_name)}")
        command: click.Command = module.command
        if cmd_name in ALIASES:
            parts = command.commands if isinstance(command, click.Group) else vars(module)
            command = parts[cmd_name]
        _accept_verbose(command)
        return command


def _show_logs(context: click.Context, parameter: click.Parameter, verbose: bool) -> None:
    if verbose:
        logging.getLogger().setLevel(logging.INFO)


def _accept_verbose(command: click.Command) -> None:
    """Accept -v also after the name of the command."""
    if any(parameter.name == "verbose" for parameter in command.params):
        return
    command.params.append(
        click.Option(
            ["-v", "--verbose"],
            is_flag=True,
            expose_value=False,
            callback=_show_logs,
            help=LOG_HELP,
        )
    )
    for inner in getattr(command, "commands", {}).values():
        _accept_verbose(inner)


@click.group(cls=LazyGroup, context_settings=CONTEXT)
@click.version_option(package_name="guara-perception", prog_name="guara")
@click.option("-v", "--verbose", is_flag=True, help=LOG_HELP)
def guara(verbose: bool) -> None:
    """Terrain perception for walking robots: terrain grids for planners, from a camera and a swept laser stripe.

    \b
    Example:
      guara process SCAN -c calibration.json -o terrain.npz --figures pictures
    """
    logging.getLogger().setLevel(logging.INFO if verbose else logging.WARNING)
    log_to_stderr()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with 0 or one of `exit_codes`; only unexpected errors print a traceback."""
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit code. An unexpected error is raised."""
    for name, value in ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    given = sys.argv[1:] if arguments is None else list(arguments)
    try:
        with _warnings_as_lines():
            code = guara.main(args=given, prog_name="guara", standalone_mode=False)
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.ctx.get_help() if error.ctx else error.format_message(), err=True)
        return EXIT_BAD_INPUT
    except (click.exceptions.Abort, KeyboardInterrupt):
        return _report("stopped", EXIT_INTERRUPTED)
    except click.ClickException as error:
        return _report(_with_help(error), EXIT_BAD_INPUT)
    except BrokenPipeError:
        # The reader has closed the pipe (`guara listen | head -1`). Redirect stdout, since flushing it at exit would
        # raise the error again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILED
    except Exception as error:
        if not is_expected(error):
            raise
        return _report(text_of(error), _code_of(error, given))
    # An integer comes from ctx.exit(code); otherwise click returns the value of the command, which is None.
    return code if isinstance(code, int) else 0


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Print Python warnings in the format of this command; those that differ only in numbers are printed once."""
    shown: set[str] = set()

    def show(message: Warning | str, *details: Any, **named: Any) -> None:
        key = NUMBER.sub("#", str(message))
        if key not in shown:
            shown.add(key)
            click.echo(f"guara: warning: {' '.join(str(message).split())}", err=True)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield


def is_expected(error: Exception) -> bool:
    """True for the error types of the packages, errors of the operating system, and missing shared libraries."""
    roots = ("PerceptionError", "KinematicsError", "TransportError", "DriverError")
    if isinstance(error, ImportError) and "cannot open shared object file" in str(error):
        return True
    return isinstance(error, OSError) or any(kind.__name__ in roots for kind in type(error).__mro__)


def is_bad_input(error: BaseException) -> bool:
    """True for errors of the input (an invalid value or file), False for failures at run time."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in DISK_FAILED:
            return False
        cause = cause.__cause__
    files = (FileNotFoundError, FileExistsError, IsADirectoryError, NotADirectoryError, PermissionError)
    return isinstance(error, (ValueError, KeyError, *files))


def _code_of(error: Exception, given: Sequence[str]) -> int:
    """Exit code of an expected error. A calibration mismatch in `guara run` has its own code, for service managers."""
    kinds = {kind.__name__ for kind in type(error).__mro__}
    if "run" in given and kinds & {"CalibrationMismatch", "CalibrationRefused"}:
        return EXIT_CALIBRATION
    return EXIT_BAD_INPUT if is_bad_input(error) else EXIT_FAILED


def text_of(error: Exception) -> str:
    """Text of an error: file and reason, without the number, for an OSError; with a remedy if libgomp is missing."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror if error.filename is None else f"{os.fsdecode(error.filename)}: {error.strerror}"
    return f"{error} (Debian: apt install libgomp1)" if "libgomp" in str(error) else str(error)


def _with_help(error: click.ClickException) -> str:
    """Text of a usage error, with the command whose help explains it."""
    text = error.format_message()
    if isinstance(error, click.UsageError) and error.ctx is not None:
        return f"{text.rstrip('.')} (see {error.ctx.command_path} --help)"
    return text


def _shortened(word: str) -> str:
    """Shorten a long word, such as a path, by leaving out its middle."""
    return word if len(word) <= LONGEST_WORD else f"{word[: LONGEST_WORD // 2]}...{word[-LONGEST_WORD // 2 :]}"


def _report(text: str, code: int) -> int:
    click.echo(f"guara: {' '.join(map(_shortened, text.split()))}", err=True)
    return code


if __name__ == "__main__":
    main()
