"""Errors and warnings of this package: one root, each also the builtin that fits."""

from __future__ import annotations

from collections.abc import Iterable


class KinematicsError(Exception):
    """Root of every error that `kinematics` raises."""

    def __str__(self) -> str:
        """The message as written: `KeyError` would quote it."""
        return str(self.args[0]) if len(self.args) == 1 else super().__str__()


class RobotNotFound(KinematicsError, FileNotFoundError):
    """No robot folder of that name or path."""


class RobotFileError(KinematicsError, ValueError):
    """A file of a robot folder is broken or contradicts another; the message names the file and the line or entry.

    Attributes:
        findings: each thing that is wrong, one or more.
    """

    findings: tuple[str, ...]

    def __init__(self, *findings: str) -> None:
        """One message of all findings."""
        super().__init__(
            findings[0]
            if len(findings) == 1
            else f"{len(findings)} findings: " + "; ".join(f"({i}) {text}" for i, text in enumerate(findings, 1))
        )
        self.findings = findings


class UnknownName(KinematicsError, KeyError):
    """A frame, joint, leg or posture that the robot does not have; the message lists those it has."""


class JointPositionError(KinematicsError, ValueError):
    """Joint positions that cannot be used: missing, not finite, not in radians, of wrong length."""


class StanceError(KinematicsError, ValueError):
    """A stance that is malformed or does not hold the body: the message names the field."""


class ArgumentError(KinematicsError, ValueError):
    """An argument of wrong shape or value; the message says what was given and what is allowed."""


class CameraMoved(KinematicsError, RuntimeError):
    """The camera moved between start and end of a scan by more than robot.toml allows."""


class OdometryLost(KinematicsError, RuntimeError):
    """Too few feet stayed between two pauses to know how the body moved."""


class JointLimitWarning(UserWarning):
    """Joints stand beyond their limits; one message says which and by how much."""


class RobotFileWarning(UserWarning):
    """Something in a robot folder is not used (one warning names all of it), or is accepted and should be corrected."""


def unknown_name(kind: str, given: object, valid: Iterable[str]) -> UnknownName:
    """An `UnknownName` whose message says what was given and lists what there is."""
    return UnknownName(f"unknown {kind} {given!r}; this robot has: {', '.join(valid)}")
