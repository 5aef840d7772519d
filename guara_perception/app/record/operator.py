"""Operator of a calibration session: a person at a terminal, asked task by task."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import click

from guara_perception.calibration.board import BoardSpec
from guara_perception.settings import Settings


class Operator(Protocol):
    """Operator who puts board, crosses and plates in front of the camera."""

    def show_board(self, advice: str) -> None:
        """Request a board held up, with advice on the next picture; returns at once."""

    def lay_board(self, board: BoardSpec, why_again: str) -> None:
        """Request the board on the floor; return when it is there. `why_again` is the fault of the last try, or ""."""

    def lay_crosses(self, points: str, why_again: str) -> None:
        """Request the crosses on the floor; return when they are there. `why_again` as in `lay_board`."""

    def lay_plate(self, height: float) -> None:
        """Request a flat plate, its top `height` [m] above the floor, or the bare floor; return when it is there."""

    def clear(self) -> None:
        """Request a plain floor and nothing else in view; return when it is clear."""


class TextOperator:
    """Operator asked on the terminal; the live page shows the same text."""

    def __init__(self, ask: Callable[[str], None], settings: Settings) -> None:
        """Print every request, and show it with `ask`; `settings` has the area for the plates."""
        self._show, self._settings = ask, settings
        self._printed = ""

    def show_board(self, advice: str) -> None:
        """Print the advice, once."""
        if advice != self._printed:
            self._print(advice)

    def lay_board(self, board: BoardSpec, why_again: str) -> None:
        """Ask for the board on the floor, with the reason why the last try failed."""
        again = f"{why_again}. " if why_again else ""
        self._ask(f"{again}Lay the board flat on the floor, entirely in the picture")

    def lay_crosses(self, points: str, why_again: str) -> None:
        """Ask for the crosses, with the reason why the last try failed."""
        again = f"{why_again}. " if why_again else ""
        self._ask(f"{again}Remove the board; lay the crosses at {points} m in base_footprint (the mat shows them)")

    def lay_plate(self, height: float) -> None:
        """Ask for a plate."""
        (x0, x1), (y0, y1) = self._settings.footprint_x, self._settings.footprint_y
        area = f"x {x0:.2f} ... {x1:.2f} m, y {y0:.2f} ... {y1:.2f} m"
        if height == 0:
            self._ask(f"Clear the floor in front of the robot: {area} and all that the camera sees")
        else:
            self._ask(
                f"Lay the plate of {1e3 * height:g} mm, {x1 - x0:.2f} x {y1 - y0:.2f} m or larger, over {area}; a "
                "smaller one, A3 or larger, where it has not been before"
            )

    def clear(self) -> None:
        """Ask for a plain floor."""
        self._ask("Robot in its scan posture on a flat floor, nothing in view; it must not move until the end")

    def _ask(self, text: str) -> None:
        self._print(text)
        click.pause("then press any key ")

    def _print(self, text: str) -> None:
        self._printed = text
        self._show(text)
        click.echo(text, err=True)
