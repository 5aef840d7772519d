"""Reader of parsed JSON that checks types, with errors that name file, field, given value and allowed values."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import FileFormatError, MissingFile
from guara_perception.files import LARGEST_TEXT, existing_file, read_bounded

# Largest number of objects in one list: a scan has 70 stripes, a session about a hundred pictures.
MOST_ITEMS = 10_000
KINDS: dict[type, str] = {
    dict: "an object",
    list: "a list",
    str: "text",
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    type(None): "null",
}


def read_json(path: str | Path) -> Fields:
    """Read a JSON file whose top level is an object.

    Raises:
        MissingFile: there is no such file, or it is a folder.
        FileFormatError: the file cannot be read, is too large, is not JSON, or contains NaN or infinity anywhere, or
            its top level is not an object.
    """
    path = Path(path)
    if path.is_dir():
        raise MissingFile(f"{path} is a folder; give the file in it")
    return parse_json(read_bounded(existing_file(path), LARGEST_TEXT), str(path))


def parse_json(content: bytes, source: str) -> Fields:
    """Parse JSON whose top level is an object.

    Args:
        content: content of the file.
        source: name of the source, for messages.

    Raises:
        FileFormatError: the content is not JSON or contains NaN or infinity anywhere, or its top level is not an
            object.
    """
    try:
        data = json.loads(content.decode())
    except (ValueError, RecursionError) as error:  # ValueError: not JSON, not UTF-8, a number of thousands of digits
        raise FileFormatError(f"{source}: not a JSON file ({error})") from None
    if not isinstance(data, dict):
        raise FileFormatError(f"{source}: the top level is {_kind(data)}; it must be a JSON object")
    refuse_not_finite(data, source)
    return Fields(data, source)


def refuse_not_finite(data: Any, source: str, path: str = "") -> None:
    """Refuse NaN and infinity anywhere in parsed JSON, including fields that this version does not read.

    Raises:
        FileFormatError: a value is not finite; the message names `source`, path and value.
    """
    if isinstance(data, dict):
        for name, value in data.items():
            refuse_not_finite(value, source, f"{path}.{name}" if path else name)
    elif isinstance(data, list | tuple):
        for i, value in enumerate(data):
            refuse_not_finite(value, source, f"{path}[{i}]")
    elif isinstance(data, float) and not math.isfinite(data):
        raise FileFormatError(f"{source}: {path} is {data}; it must be finite")


class Fields:
    """JSON object whose fields are checked when they are read; a missing or wrong value raises FileFormatError.

    Attributes:
        data: the parsed object.
        source: file name for messages.
        path: dotted path of the object inside the file, empty for the top level.
    """

    def __init__(self, data: Mapping[str, Any], source: str, path: str = "") -> None:
        self.data = data
        self.source = source
        self.path = path

    def path_to(self, name: str) -> str:
        """Name of a field for a message: file and dotted path."""
        return f"{self.source}: {self._below(name)}"

    def _below(self, name: str) -> str:
        return f"{self.path}.{name}" if self.path else name

    def has(self, name: str) -> bool:
        """Test that a field exists and is not null."""
        return self.data.get(name) is not None

    def raw(self, name: str) -> Any:
        """Field as parsed; a missing or null field is refused."""
        if name not in self.data:
            raise FileFormatError(f"{self.path_to(name)} is missing")
        value = self.data[name]
        if value is None:
            raise FileFormatError(f"{self.path_to(name)} is null; a value is needed")
        return value

    def text(self, name: str, allowed: tuple[str, ...] | None = None) -> str:
        """Text field; one of `allowed`, if given."""
        value: str = self._of_type(name, str)
        if allowed is not None and value not in allowed:
            raise FileFormatError(f"{self.path_to(name)} is {value!r}, allowed: {', '.join(map(repr, allowed))}")
        return value

    def integer(self, name: str, minimum: int | None = None, maximum: int | None = None) -> int:
        """Whole number within bounds (inclusive)."""
        value: int = self._of_type(name, int)
        self._check_bounds(name, value, minimum, maximum)
        return value

    def number(self, name: str, minimum: float | None = None, maximum: float | None = None, unit: str = "") -> float:
        """Finite number within bounds (inclusive); messages append `unit` to the bounds."""
        try:
            number = float(self._of_type(name, float))
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise FileFormatError(f"{self.path_to(name)} is {number}; it must be finite")
        self._check_bounds(name, number, minimum, maximum, unit)
        return number

    def array(self, name: str, shape: tuple[int | None, ...]) -> Float:
        """Nested list of finite numbers, as an array of the given shape (None = any length)."""
        value = self.raw(name)
        wanted = "x".join("n" if n is None else str(n) for n in shape)
        if not _holds_numbers_only(value):
            raise FileFormatError(f"{self.path_to(name)} is not an array of {wanted} numbers")
        try:
            array = np.array(value, dtype=np.float64)
        except (ValueError, OverflowError):  # ragged, or a whole number beyond 1e308
            raise FileFormatError(f"{self.path_to(name)} is not an array of {wanted} numbers") from None
        fits = array.ndim == len(shape) and all(w is None or w == n for w, n in zip(shape, array.shape, strict=False))
        if not fits:
            given = f"has shape {'x'.join(map(str, array.shape))}" if array.ndim else "is a single number"
            needed = wanted if array.ndim else f"an array of {wanted} numbers"
            raise FileFormatError(f"{self.path_to(name)} {given}; it must be {needed}")
        if not np.isfinite(array).all():
            raise FileFormatError(f"{self.path_to(name)} holds NaN or infinity; all values must be finite")
        return array

    def sub(self, name: str) -> Fields:
        """Nested object."""
        return Fields(self._of_type(name, dict), self.source, self._below(name))

    def items(self, name: str) -> Iterator[Fields]:
        """Iterate over a list of up to MOST_ITEMS objects."""
        values = self.sequence(name)
        if len(values) > MOST_ITEMS:
            raise FileFormatError(f"{self.path_to(name)} has {len(values)} items, allowed: up to {MOST_ITEMS}")
        for i, value in enumerate(values):
            if not isinstance(value, dict):
                raise FileFormatError(f"{self.path_to(name)}[{i}] is {_kind(value)}; it must be an object")
            yield Fields(value, self.source, f"{self._below(name)}[{i}]")

    def sequence(self, name: str) -> list[Any]:
        """List whose elements are not checked."""
        found: list[Any] = self._of_type(name, list)
        return found

    def _of_type(self, name: str, kind: type) -> Any:
        """Value of a field, checked to be of a type. Integers count as numbers; booleans do not."""
        value = self.raw(name)
        if isinstance(value, bool) or not isinstance(value, (int, float) if kind is float else kind):
            raise FileFormatError(f"{self.path_to(name)} is {_kind(value)}; it must be {KINDS[kind]}")
        return value

    def _check_bounds(
        self, name: str, value: float, minimum: float | None, maximum: float | None, unit: str = ""
    ) -> None:
        if (minimum is not None and value < minimum) or (maximum is not None and value > maximum):
            low = "-inf" if minimum is None else minimum
            high = "inf" if maximum is None else maximum
            raise FileFormatError(f"{self.path_to(name)} is {value}, allowed: {low} ... {high}{unit}")


def _holds_numbers_only(value: Any) -> bool:
    """Test that a nested list contains nothing but numbers; NumPy would silently convert "1" and true to numbers."""
    if isinstance(value, list):
        # The types of a whole list at once, because a calibration holds thousands of numbers.
        return set(map(type, value)) <= {int, float} or all(map(_holds_numbers_only, value))
    return isinstance(value, int | float) and not isinstance(value, bool)


def _kind(value: Any) -> str:
    return KINDS.get(type(value), type(value).__name__)
