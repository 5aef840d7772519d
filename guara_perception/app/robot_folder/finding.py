"""Findings of `guara robot check`."""

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
    """Finding about a robot folder.

    Attributes:
        weight: "unusable" if the robot cannot be used at all, "wrong" for an error that should be corrected, "note" for
            information.
        subject: the file, table, leg, link, posture or walk concerned.
        text: the finding, with a remedy where one is known.
    """

    weight: Weight
    subject: str
    text: str

    def __str__(self) -> str:
        """Return the finding as one line of text."""
        return f"{self.weight.value}: {self.subject}: {self.text}"

    def to_dict(self) -> dict[str, str]:
        """Convert the finding to plain values, for JSON."""
        return {"weight": self.weight.value, "place": self.subject, "text": self.text}


def wrong(subject: str, text: str) -> Finding:
    """Create a finding that should be corrected."""
    return Finding(Weight.WRONG, subject, text)


def note(subject: str, text: str) -> Finding:
    """Create a finding that is for information only."""
    return Finding(Weight.NOTE, subject, text)
