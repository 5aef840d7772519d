"""Operator of a calibration session: interface, and implementation that asks a person at the terminal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import click

from guara_perception.calibration.board import BoardSpec
from guara_perception.settings import Settings


class Operator(Protocol):
    """Person or program that places board, crosses and plates in front of the camera on request."""

    def show_board(self, advice: str) -> None:
        """Request to hold up the board, with advice on the next image; return immediately."""

    def lay_board(self, board: BoardSpec, why_again: str) -> None:
        """Request the board on the floor; return when it is there.

        `why_again` is the reason why the last attempt failed, or "".
        """

    def lay_crosses(self, points: str, why_again: str) -> None:
        """Request the crosses on the floor at `points`, given as text; return when they are there.

        `why_again` is as in `lay_board`.
        """

    def lay_plate(self, height: float) -> None:
        """Request a plate with its top at `height` [m], or the bare floor at 0; return when it is in place."""

    def clear(self) -> None:
        """Request a bare floor with nothing else in view; return when it is clear."""


class TextOperator:
    """Operator at the terminal. The live page shows the same requests."""

    def __init__(self, ask: Callable[[str], None], settings: Settings) -> None:
        """Create the operator.

        Args:
            ask: called with the text of every request, which is also printed.
            settings: settings with the scanned area, for the position of the plates.
        """
        self._show, self._settings = ask, settings
        self._printed = ""

    def show_board(self, advice: str) -> None:
        """Print the advice unless it was the last text printed."""
        if advice != self._printed:
            self._print(advice)

    def lay_board(self, board: BoardSpec, why_again: str) -> None:
        """Ask for the board on the floor, with the reason why the last attempt failed, if any."""
        again = f"{why_again}. " if why_again else ""
        self._ask(f"{again}Lay the board flat on the floor, entirely in the picture")

    def lay_crosses(self, points: str, why_again: str) -> None:
        """Ask for the crosses, with the reason why the last attempt failed, if any."""
        again = f"{why_again}. " if why_again else ""
        self._ask(f"{again}Remove the board; lay the crosses at {points} m in base_footprint (the mat shows them)")

    def lay_plate(self, height: float) -> None:
        """Ask for a plate, or for the bare floor at height 0."""
        (x0, x1), (y0, y1) = self._settings.footprint_x, self._settings.footprint_y
        area = f"x {x0:.2f} ... {x1:.2f} m, y {y0:.2f} ... {y1:.2f} m"
        if height == 0:
            self._ask(f"Clear the floor in front of the robot: {area} and everything else in view")
        else:
            self._ask(
                f"Lay the plate of {1e3 * height:g} mm, {x1 - x0:.2f} x {y1 - y0:.2f} m or larger, over {area}. A "
                "smaller plate must be at least A3; lay it where it has not been scanned yet"
            )

    def clear(self) -> None:
        """Ask for a bare floor, with the robot in its scan posture."""
        self._ask(
            "Put the robot in its scan posture on a flat floor with nothing else in view. It must not move until the "
            "end"
        )

    def _ask(self, text: str) -> None:
        self._print(text)
        click.pause("then press any key ")

    def _print(self, text: str) -> None:
        self._printed = text
        self._show(text)
        click.echo(text, err=True)
