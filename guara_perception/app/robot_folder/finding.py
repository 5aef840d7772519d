"""One finding of `guara robot check`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Weight(Enum):
    """How much a finding matters."""

    UNUSABLE = "unusable"
    WRONG = "wrong"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found in one file, table, leg or link of a robot folder.

    Attributes:
        weight: unusable: the robot does not load; wrong: it loads, but this should be mended; note: good to know.
        subject: the file, table, leg or link.
        text: what is wrong, and what to do about it.
    """

    weight: Weight
    subject: str
    text: str

    def __str__(self) -> str:
        """In one line."""
        return f"{self.weight.value}: {self.subject}: {self.text}"

    def to_dict(self) -> dict[str, str]:
        """As plain values, for JSON."""
        return {"weight": self.weight.value, "place": self.subject, "text": self.text}


def wrong(subject: str, text: str) -> Finding:
    """Something to mend."""
    return Finding(Weight.WRONG, subject, text)


def note(subject: str, text: str) -> Finding:
    """Something to know."""
    return Finding(Weight.NOTE, subject, text)
