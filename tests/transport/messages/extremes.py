"""Messages in which one field is an extreme of its type: of every field of every message, in those within it too."""

import copy
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from transport.messages.typestore import typestore

FLOATS = (math.nan, math.inf, -math.inf, 0.0, -0.0, -1.0, 5e-324, 1e-300, 1e-30, 1e10, 1e12, 1e38, 1e300, -1e300)
BYTES_OF_LONG_TEXT = 20_000


def _values(kind: str, now: Any) -> tuple[Any, ...]:
    if kind == "string":
        return (
            "",
            "x" * BYTES_OF_LONG_TEXT,
            "\n\t ",
            "é" * 300,
            "nan",
            "inf",
            "1e400",
            "-1",
            "9" * 5000,
            "[" * 9000,
            "{}",
        )
    if kind == "bool":
        return (False, True)
    if kind.startswith("float"):
        return tuple(value for value in FLOATS if kind == "float64" or not 1e38 < abs(value) < math.inf)
    limits = np.iinfo(np.dtype("uint8" if kind in ("byte", "char", "octet") else kind))
    return (int(limits.min), int(limits.max), 0, 1, 2, 3, 4, 200)


def extremes(message: Any, at: str = "") -> Iterator[tuple[str, Any]]:
    """Name of a field and a copy of the message in which it is an extreme; one field at a time.

    Of lists: empty, very long, and each extreme in the first entry.
    """
    for field, (kind, details) in typestore().get_msgdef(message.__msgtype__).fields:
        name, now = f"{at}{field}", getattr(message, field)
        if kind == 1:
            values: tuple[Any, ...] = _values(details[0], now)
        elif kind == 2:
            values = ()
            yield from ((inner, _with(message, field, value)) for inner, value in extremes(now, f"{name}."))
        else:
            (inner_kind, inner_type), _ = details
            values = (now[:0], _repeated(now, 3), _repeated(now, 2000))
            if len(now) and inner_kind == 2:
                yield from (
                    (inner, _with(message, field, [value, *now[1:]]))
                    for inner, value in extremes(now[0], f"{name}[0].")
                )
            elif len(now):
                values = (*values, *(_first(now, value) for value in _values(inner_type[0], now[0])))
        for value in values:
            yield name, _with(message, field, value)


def _with(message: Any, field: str, value: Any) -> Any:
    changed = copy.copy(message)
    object.__setattr__(changed, field, value)
    return changed


def _repeated(values: Any, times: int) -> Any:
    return np.tile(values, times) if isinstance(values, np.ndarray) else list(values) * times


def _first(values: Any, value: Any) -> Any:
    if isinstance(values, np.ndarray):
        changed = values.copy()
        changed[0] = value
        return changed
    return [value, *values[1:]]
