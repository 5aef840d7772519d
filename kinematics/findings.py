"""Errors in a file of a robot folder, collected so that all can be reported at once."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from kinematics.exceptions import RobotFileError


class Findings:
    """Collector of errors in one file, and of notes on content that is not used or cannot be checked.

    Args:
        path: path of the file, for messages.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._wrong: list[tuple[int, str]] = []
        self._unused: Counter[str] = Counter()

    def wrong(self, text: str, line: int = 0) -> None:
        """Add an error.

        Args:
            text: description of the error.
            line: line of the file, counted from 1; 0 = no particular line.
        """
        self._wrong.append((line, text))

    def unused(self, text: str) -> None:
        """Add a note on content that is not used or cannot be checked; equal texts become one note with a count."""
        self._unused[text] += 1

    @property
    def is_wrong(self) -> bool:
        """True if there are errors."""
        return bool(self._wrong)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on content that is not used or cannot be checked, equal texts merged."""
        return tuple(f"{text} ({count} times)" if count > 1 else text for text, count in self._unused.items())

    @property
    def texts(self) -> tuple[str, ...]:
        """Errors in the order of their lines, each with the file, and with the line if it is known."""
        return tuple(
            f"{self.path}:{line}: {text}" if line else f"{self.path}: {text}"
            for line, text in sorted(self._wrong, key=lambda finding: finding[0])
        )

    def refuse(self) -> None:
        """Raise an error if there are errors in the file; notes alone do not raise.

        Raises:
            RobotFileError: there are errors; its `findings` are `texts`.
        """
        if self._wrong:
            raise RobotFileError(*self.texts)
