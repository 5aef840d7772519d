"""One table of a TOML file, its values checked as they are read; messages name the file and the key."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from kinematics.exceptions import RobotFileError


class Table:
    """A view of one table: `number`, `text` and the others read a value or say what is wrong with it.

    Args:
        path: the file, for messages.
        name: the table's name with dots, "" for the whole file.
        values: what the TOML reader gave.
    """

    def __init__(self, path: Path, name: str, values: Mapping[str, object]) -> None:
        """Keep the values; nothing is checked yet."""
        self.path = path
        self.name = name
        self.values = values

    def _get(self, key: str) -> object:
        if key not in self.values:
            raise RobotFileError(f"{self.path}: {self._place(key)} is missing")
        return self.values[key]

    def _place(self, key: str) -> str:
        return f"[{self.name}] {key}" if self.name else key

    def refuse(self, key: str, needed: str) -> RobotFileError:
        """The error that says what was given for a key and what is needed."""
        return RobotFileError(f"{self.path}: {self._place(key)} is {self.values.get(key)!r}; {needed} is needed")

    def number(self, key: str, *, above: float = -math.inf, least: float = -math.inf) -> float:
        """A finite number greater than `above` and not below `least`."""
        value = self._get(key)
        if not _is_number(value) or not value > above or value < least:  # type: ignore[operator]
            bound = f" above {above:g}" if above > -math.inf else f" of {least:g} or more" if least > -math.inf else ""
            raise self.refuse(key, f"a number{bound}")
        return float(value)  # type: ignore[arg-type]

    def integer(self, key: str, *, least: int) -> int:
        """A whole number of at least `least`."""
        value = self._get(key)
        if not isinstance(value, int) or isinstance(value, bool) or value < least:
            raise self.refuse(key, f"a whole number of at least {least}")
        return value

    def text(self, key: str) -> str:
        """A text that is not empty."""
        value = self._get(key)
        if not isinstance(value, str) or not value:
            raise self.refuse(key, "a text")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts, each once; it may be empty."""
        value = self._get(key)
        if not isinstance(value, list) or not all(isinstance(item, str) and item for item in value):
            raise self.refuse(key, "a list of texts")
        if len(set(value)) != len(value):
            raise self.refuse(key, "a list in which every name stands once")
        return tuple(value)

    def pair(self, key: str, *, above: float = -math.inf) -> tuple[float, float]:
        """Two finite numbers, each greater than `above`."""
        value = self._get(key)
        if not isinstance(value, list) or len(value) != 2:
            raise self.refuse(key, "a list of two numbers")
        if not all(_is_number(item) and item > above for item in value):
            raise self.refuse(key, "a list of two numbers" + (f" above {above:g}" if above > -math.inf else ""))
        return (float(value[0]), float(value[1]))

    def table(self, key: str) -> Table:
        """The table of that name below this one."""
        name = f"{self.name}.{key}" if self.name else key
        if key not in self.values:
            raise RobotFileError(f"{self.path}: the table [{name}] is missing")
        value = self.values[key]
        if not isinstance(value, Mapping):
            raise RobotFileError(f"{self.path}: {name} is {value!r}; a table [{name}] is needed")
        return Table(self.path, name, value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def frozen(value: object) -> object:
    """The same TOML value with read-only mappings and tuples, all the way down."""
    if isinstance(value, Mapping):
        return MappingProxyType({key: frozen(item) for key, item in value.items()})
    if isinstance(value, list):
        return tuple(frozen(item) for item in value)
    return value
