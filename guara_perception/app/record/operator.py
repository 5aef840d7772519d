"""Who puts board, crosses and plates before the camera: a person at a terminal, asked task by task."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import click

from guara_perception.calibration.board import BoardSpec


class Operator(Protocol):
    """Puts things where the camera sees them."""

    def show_board(self, advice: str) -> None:
        """A board is being held up; `advice` says what is missing. Returns at once: the camera watches."""

    def lay_board(self, board: BoardSpec) -> None:
        """The board lies on the floor, in view; returns when it does."""

    def lay_crosses(self, points: str, why_again: str) -> None:
        """The crosses lie on the floor; `why_again` says what was wrong the last time. Returns when they do."""

    def lay_plate(self, height: float) -> None:
        """A flat plate whose top is `height` [m] above the floor fills the view; returns when it does."""

    def clear(self) -> None:
        """Only a plain floor is in view; returns when it is."""


class TextOperator:
    """Asks a person on the terminal; the live page shows the same text."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        """Show every line with `tell` too."""
        self._tell = tell
        self._said = ""

    def show_board(self, advice: str) -> None:
        """Say what is missing, once."""
        if advice != self._said:
            self._say(advice)

    def lay_board(self, board: BoardSpec) -> None:
        """Ask for the board on the floor."""
        self._ask("Lay the board flat on the floor, wholly in the picture")

    def lay_crosses(self, points: str, why_again: str) -> None:
        """Ask for the crosses, with the reason when they were not found."""
        again = f"{why_again}. " if why_again else ""
        self._ask(f"{again}Take the board away; the crosses lie at {points} m in base_footprint (the mat shows them)")

    def lay_plate(self, height: float) -> None:
        """Ask for a plate."""
        what = "Clear the floor before the robot" if height == 0 else f"Lay the plate of {1e3 * height:g} mm"
        self._ask(f"{what}, so that it fills the scanned area")

    def clear(self) -> None:
        """Ask for a plain floor."""
        self._ask("Robot in its scan posture on a flat floor, nothing in view; it must not move until the end")

    def _ask(self, text: str) -> None:
        self._say(text)
        click.pause(f"{text}; then press any key ")

    def _say(self, text: str) -> None:
        self._said = text
        self._tell(text)
        click.echo(text, err=True)
