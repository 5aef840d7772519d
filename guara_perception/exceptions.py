"""Errors of guara_perception, and shared functions that raise or convert them."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class PerceptionError(Exception):
    """Base class of the errors of this package.

    `guara_perception.Errors` also contains those of `kinematics`, `transport` and `drivers`.
    """


class InvalidInput(PerceptionError, ValueError):
    """An argument that cannot be used; the message names what was given and what is allowed."""


class MissingFile(PerceptionError, FileNotFoundError):
    """A file or folder that does not exist, or a folder given in place of a file."""


class FileFormatError(PerceptionError, ValueError):
    """A file that cannot be read, or whose content is invalid; the message names file and fault.

    Attributes:
        findings: descriptions of the errors, one or more.
    """

    findings: tuple[str, ...]

    def __init__(self, *findings: str) -> None:
        """Join all findings in one message."""
        numbered = "; ".join(f"({number}) {text}" for number, text in enumerate(findings, 1))
        super().__init__(findings[0] if len(findings) == 1 else f"{len(findings)} errors: {numbered}")
        self.findings = findings


class CalibrationMismatch(PerceptionError, ValueError):
    """Scan, robot, camera or calibration that do not belong together."""


class CalibrationRefused(PerceptionError, RuntimeError):
    """A calibration that cannot be computed, or whose quality verdict is `refused`."""


class UnsafeGrid(PerceptionError, RuntimeError):
    """A grid that violates the safety invariant, or whose layers are malformed; it must not be sent or used."""


class PlannerFailed(PerceptionError, RuntimeError):
    """The planner process of the demo has ended or does not answer."""


class ViewerFailed(PerceptionError, RuntimeError):
    """The viewer of a scene ended with an error."""


class MirrorSlipped(PerceptionError, RuntimeError):
    """The mirror lost motor steps during a scan, so that the measured heights are wrong."""


class DamagedInstallation(PerceptionError, ImportError):
    """The compiled kernel of the package is missing or cannot be loaded; the message says how to reinstall it."""


class MissingExtra(PerceptionError, ImportError):
    """A library, or a part of the package, that is not installed; the message says what to install."""


def optional_library(name: str, extra: str | None, purpose: str) -> Any:
    """Import a library that belongs to an extra or is not a dependency of guara-client.

    Args:
        name: name of the module.
        extra: extra of guara-perception that includes the library; None = guara-perception itself depends on it.
        purpose: feature that needs the library, for the message.

    Raises:
        MissingExtra: the library cannot be imported.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        distribution = f"'guara-perception[{extra}]'" if extra else "guara-perception"
        raise MissingExtra(f"{purpose} needs {name}: pip install {distribution}") from None


def refuse_stale(stale_because: tuple[str, ...], allow_stale: bool) -> None:
    """Reject a query of a stale grid, unless the caller allows it.

    Args:
        stale_because: reasons why the grid is stale; empty for a grid that is not.
        allow_stale: True to allow queries of a stale grid.

    Raises:
        transport.StaleTerrain: the grid is stale, and `allow_stale` is False.
    """
    if stale_because and not allow_stale:
        # Imported here, so that programs that only compute grids do not load transport.
        from transport.exceptions import StaleTerrain

        raise StaleTerrain(f"{'; '.join(stale_because)}. Query a newer grid; allow_stale=True answers from this one")


@contextmanager
def errors_as(kind: type[PerceptionError], source: object, *causes: type[Exception]) -> Iterator[None]:
    """Convert errors of the types `causes` to errors of type `kind`; `source`, unless empty, precedes the message."""
    try:
        yield
    except causes as error:
        raise kind(f"{source}: {error}" if source else str(error)) from None
