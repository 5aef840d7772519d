"""Table of a TOML file whose values are checked when they are read; messages name the file, the line and the key."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, TypeVar

from kinematics.findings import Findings

T = TypeVar("T")


class Table:
    """One table of a TOML file; `number`, `text` and similar methods read and check a value.

    A wrong or missing value raises RobotFileError. In a table made by `gathering`, it is recorded as a finding instead
    and replaced by a value of the same type, which may be outside the allowed range.

    Args:
        path: the file, for messages.
        name: dotted name of the table; "" for the whole file.
        values: content of the table, from the TOML parser.
        lines: dotted name of a table or key -> line of the file.
    """

    def __init__(
        self, path: Path, name: str, values: Mapping[str, object], lines: Mapping[str, int] | None = None
    ) -> None:
        self.path = path
        self.name = name
        self.values = values
        self._lines = lines or {}
        self._findings: Findings | None = None
        self._is_absent = False

    def gathering(self, findings: Findings) -> Table:
        """Copy of this table whose wrong values become findings instead of errors."""
        return self._below(self.name, self.values, findings)

    def line(self, key: str = "") -> int:
        """Line of a key, or of this table if that of the key is unknown; 0 if both are unknown."""
        return self._lines.get(self._dotted(key), self._lines.get(self.name, 0))

    def wrong(self, key: str, needed: str) -> None:
        """Report the value given for a key and what is needed.

        Raises:
            RobotFileError: the table does not gather findings.
        """
        self._report(f"{self._path_of(key)} is {self.values.get(key)!r}; {needed} is needed", key)

    def number(self, key: str, *, above: float = -math.inf, least: float = -math.inf, most: float = math.inf) -> float:
        """Finite number above `above`, at least `least` and at most `most`."""

        def is_within(value: Any) -> bool:
            return _is_number(value) and value > above and least <= value <= most

        return float(self._value(key, is_within, f"a number{_bounds(above, least, most)}", 1.0))

    def integer(self, key: str, *, least: int, most: int | None = None) -> int:
        """Whole number of at least `least` and, if given, at most `most`."""

        def is_within(value: Any) -> bool:
            return isinstance(value, int) and _is_number(value) and least <= value <= (value if most is None else most)

        needed = f"a whole number of at least {least}{'' if most is None else f' and at most {most}'}"
        return int(self._value(key, is_within, needed, least))

    def record(self, kind: type[T]) -> T:
        """Dataclass whose fields are numbers, each from the key of the same name; fields with a default need no key.

        Each number must be within the bounds in the field's metadata. Without metadata, it must be above 0, or at least
        1 in a field of type int.
        """
        values = {}
        for each in fields(kind):  # type: ignore[arg-type]
            if each.default is MISSING or each.name in self.values:
                is_whole = each.type == "int"
                bounds = each.metadata or {"least" if is_whole else "above": 1 if is_whole else 0.0}
                values[each.name] = (self.integer if is_whole else self.number)(each.name, **bounds)
        return kind(**values)

    def text(self, key: str) -> str:
        """Non-empty string; in a gathering table, "" replaces a wrong or missing value."""
        return str(self._value(key, _is_text, "a non-empty string", ""))

    def texts(self, key: str) -> tuple[str, ...]:
        """List of different non-empty strings; the list may be empty."""
        value = self._value(
            key, lambda given: isinstance(given, list) and all(map(_is_text, given)), "a list of non-empty strings", []
        )
        if len(set(value)) != len(value):
            self.wrong(key, "a list of different names")
            return ()
        return tuple(value)

    def pair(
        self, key: str, *, above: float = -math.inf, most: float = math.inf, rising: bool = False
    ) -> tuple[float, float]:
        """Two finite numbers, each above `above` and at most `most`; with `rising`, the second is larger."""

        def is_pair(given: Any) -> bool:
            is_two = isinstance(given, list) and len(given) == 2
            return is_two and all(_is_number(item) and above < item <= most for item in given)

        needed = f"a list of two numbers{_bounds(above, -math.inf, most)}"
        low, high = map(float, self._value(key, is_pair, needed, (1.0, 2.0)))
        if rising and low >= high:
            self.wrong(key, "a list of two numbers, the first below the second,")
        return low, high

    def table(self, key: str) -> Table:
        """Table of the given name inside this table; when gathering, an empty table replaces a missing or wrong one."""
        name = self._dotted(key)
        value = self.values.get(key)
        if isinstance(value, Mapping):
            return self._below(name, value, self._findings)
        if key in self.values:
            self._report(f"{name} is {value!r}; a table [{name}] is needed", key)
        elif not self._is_absent:
            self._report(f"the table [{name}] is missing; add it", key)
        absent = self._below(name, {}, self._findings)
        absent._is_absent = True
        return absent

    def _below(self, name: str, values: Mapping[str, object], findings: Findings | None) -> Table:
        table = Table(self.path, name, values, self._lines)
        table._findings = findings
        return table

    def _value(self, key: str, is_allowed: Callable[[Any], bool], needed: str, instead: Any) -> Any:
        """Value of a key; a missing or wrong value is reported and replaced by `instead`."""
        if key in self.values:
            if is_allowed(self.values[key]):
                return self.values[key]
            self.wrong(key, needed)
        elif not self._is_absent:
            self._report(f"{self._path_of(key)} is missing; add it", key)
        return instead

    def _report(self, text: str, key: str) -> None:
        findings = self._findings or Findings(self.path)
        findings.wrong(text, self.line(key))
        if self._findings is None:
            findings.refuse()

    def _dotted(self, key: str) -> str:
        return ".".join(part for part in (self.name, key) if part)

    def _path_of(self, key: str) -> str:
        return f"[{self.name}] {key}" if self.name else key


def _bounds(above: float, least: float, most: float) -> str:
    low = f" above {above:g}" if above > -math.inf else f" of {least:g} or more" if least > -math.inf else ""
    return low if most == math.inf else f"{low} and at most {most:.4g}"


def _is_number(value: object) -> bool:
    # `math.isfinite` would raise for a whole number of 400 digits.
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _is_text(value: object) -> bool:
    return isinstance(value, str) and bool(value)
