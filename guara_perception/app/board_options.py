"""Options of the board and the plates that a calibration looks at."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click


def board_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options --board, --pattern, --square and --plates."""
    options = (
        click.option("--board", default="9x7", show_default=True, help="inner corners of the board, COLUMNSxROWS"),
        click.option(
            "--pattern",
            type=click.Choice(["checkerboard", "charuco"]),
            default="checkerboard",
            show_default=True,
            help="pattern of the board; a charuco board need not be wholly in the picture",
        ),
        click.option("--square", type=float, default=0.030, show_default=True, help="edge of the board's squares [m]"),
        click.option("--plates", default="0,0.04,0.08", show_default=True, help="heights of the plates [m]"),
    )
    for option in reversed(options):
        command = option(command)
    return command
