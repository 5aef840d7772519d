"""Errors and warnings of this package; every error derives from `KinematicsError` and from a built-in exception."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeVar

T = TypeVar("T")


class KinematicsError(Exception):
    """Root of every error that `kinematics` raises."""

    def __str__(self) -> str:
        """Return the message without the quotes that `KeyError` would add."""
        return str(self.args[0]) if len(self.args) == 1 else super().__str__()


class RobotNotFound(KinematicsError, FileNotFoundError):
    """There is no robot folder with the given name or path."""


class LibraryMissing(KinematicsError, ImportError):
    """A library that a robot needs is not installed; the message says what to install."""


class RobotFileError(KinematicsError, ValueError):
    """A file of a robot folder is invalid or contradicts another; the message names the file and the line or entry.

    Attributes:
        findings: descriptions of the errors, one or more.
    """

    findings: tuple[str, ...]

    def __init__(self, *findings: str) -> None:
        """Join all findings into one message."""
        super().__init__(
            findings[0]
            if len(findings) == 1
            else f"{len(findings)} errors: " + "; ".join(f"({i}) {text}" for i, text in enumerate(findings, 1))
        )
        self.findings = findings


class UnknownName(KinematicsError, KeyError):
    """The robot has no such frame, link, joint, leg or posture; the message lists those that exist."""


class JointPositionError(KinematicsError, ValueError):
    """Joint positions or velocities are missing, not finite numbers, clearly not in radians, or of the wrong shape."""


class StanceError(KinematicsError, ValueError):
    """A stance is malformed, lacks required data or cannot support the body, or a leg cannot reach a foothold."""


class ArgumentError(KinematicsError, ValueError):
    """An argument has a wrong shape or value; the message states what was given and what is allowed."""


class CameraMoved(KinematicsError, RuntimeError):
    """The camera moved during a scan by more than robot.toml allows, or cannot be shown to stand still.

    The latter is the case if standing feet moved relative to each other, or if the joints are much noisier than
    robot.toml states.
    """


class OdometryLost(KinematicsError, RuntimeError):
    """Too few feet stayed in place between two pauses to compute the body's motion."""


class JointLimitWarning(UserWarning):
    """Joints beyond their limits; the message states the excess of the first three and counts the others."""


class RobotFileWarning(UserWarning):
    """Content of a robot folder that is ignored, or accepted although it should be corrected."""


def unknown_name(kind: str, given: object, valid: Iterable[str]) -> UnknownName:
    """Create an `UnknownName` whose message quotes the given name and lists the valid ones."""
    return UnknownName(f"unknown {kind} {given!r}; this robot has: {', '.join(valid)}")


def named(kind: str, name: str, valid: Mapping[str, T]) -> T:
    """Look up the value of a name.

    Raises:
        UnknownName: there is no such name; the message lists the valid ones.
    """
    if name not in valid:
        raise unknown_name(kind, name, valid)
    return valid[name]
