"""What is wrong with a file of a robot folder, gathered so that all of it is reported at once."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from kinematics.exceptions import RobotFileError


class Findings:
    """Collects what is wrong with one file, and what in it is not used.

    Args:
        path: the file, for messages.
    """

    def __init__(self, path: Path) -> None:
        """Nothing is found yet."""
        self.path = path
        self._wrong: list[tuple[int, str]] = []
        self._unused: Counter[str] = Counter()

    def wrong(self, text: str, line: int = 0) -> None:
        """Something that is used is wrong; `line` of the file, 0 when it is of no line."""
        self._wrong.append((line, text))

    def unused(self, text: str) -> None:
        """Something is not used; the same text is reported once, with its count."""
        self._unused[text] += 1

    @property
    def is_wrong(self) -> bool:
        """Whether anything is wrong so far."""
        return bool(self._wrong)

    @property
    def notes(self) -> tuple[str, ...]:
        """What is not used, each once."""
        return tuple(f"{text} ({count} times)" if count > 1 else text for text, count in self._unused.items())

    @property
    def texts(self) -> tuple[str, ...]:
        """What is wrong, in the order of the file, each with file and line."""
        return tuple(
            f"{self.path}:{line}: {text}" if line else f"{self.path}: {text}"
            for line, text in sorted(self._wrong, key=lambda finding: finding[0])
        )

    def refuse(self) -> None:
        """Raise all that was found in one go.

        Raises:
            RobotFileError: something is wrong; `findings` lists each with file and line.
        """
        if self._wrong:
            raise RobotFileError(*self.texts)
