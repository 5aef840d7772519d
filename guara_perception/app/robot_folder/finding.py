"""One finding of `guara robot check`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Weight(Enum):
    """Severity of a finding."""

    UNUSABLE = "unusable"
    WRONG = "wrong"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Finding:
    """Finding in one file, table, leg or link of a robot folder.

    Attributes:
        weight: unusable: the robot does not load; wrong: it loads, but this should be corrected; note: good to know.
        subject: the file, table, leg or link.
        text: the fault, and what to do about it.
    """

    weight: Weight
    subject: str
    text: str

    def __str__(self) -> str:
        """One line of text."""
        return f"{self.weight.value}: {self.subject}: {self.text}"

    def to_dict(self) -> dict[str, str]:
        """Plain values, for JSON."""
        return {"weight": self.weight.value, "place": self.subject, "text": self.text}


def wrong(subject: str, text: str) -> Finding:
    """Finding that should be corrected."""
    return Finding(Weight.WRONG, subject, text)


def note(subject: str, text: str) -> Finding:
    """Finding that is good to know."""
    return Finding(Weight.NOTE, subject, text)
