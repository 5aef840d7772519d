"""What is optional: names the extra to install when a library is missing."""

from __future__ import annotations

import importlib
from typing import Any

from guara_perception.exceptions import PerceptionError


class MissingExtra(PerceptionError, ImportError):
    """A library of an extra is not installed; the message says what to install."""


def optional_library(name: str, extra: str, purpose: str) -> Any:
    """Import a library that belongs to an extra.

    Args:
        name: name of the module.
        extra: extra of this package that brings it.
        purpose: what it is needed for.

    Raises:
        MissingExtra: it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise MissingExtra(f"{purpose} needs {name}: pip install 'guara-perception[{extra}]'") from None
