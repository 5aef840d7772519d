"""Reads a world from a TOML file; an unknown key or a wrong value is refused with its line."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile
from guara_perception.simulation.features import KINDS, AnyFeature
from guara_perception.simulation.light import Light
from guara_perception.simulation.real_light import real_light
from guara_perception.simulation.world import World
from kinematics.toml_text import LARGEST_FILE, parse_toml

WORLDS = Path(__file__).resolve().parent / "worlds"
"""Worlds that come with the package, found by name."""

_TABLE = re.compile(r"^\s*\[\[?\s*([A-Za-z_]+)\s*\]\]?")
_KEY = re.compile(r"^\s*([A-Za-z_]+)\s*=")
LIGHT = "light"
_TYPES = {"float": "a number", "int": "a whole number", "str": "a text", "tuple[float, float]": "two numbers"}


def load_world(name_or_path: str | Path) -> World:
    """Read a world file.

    Top level: `x`, `y` (area, two numbers each), `material`, `undulation`, `flat_until`, `seed`; then a table
    `[[box]]`, `[[rock]]`, `[[ramp]]`, `[[pit]]`, `[[patch]]`, `[[step]]` or `[[stairs]]` for each thing on the ground,
    put down in the order of the file. Metres and radians. A table `[light]` gives effects of real light by name, each
    as a fraction of what photographs show (`real_light`).

    Args:
        name_or_path: a .toml file, or the name of a world that comes with the package.

    Raises:
        MissingFile: there is neither such a file nor such a world; the message lists the names.
        FileFormatError: the file is wrong; the message names file and line, what was given and what is allowed.
    """
    path = Path(name_or_path)
    named = WORLDS / f"{name_or_path}.toml"
    if path.suffix != ".toml" and named.is_file():
        path = named
    if not path.is_file():
        names = ", ".join(sorted(p.stem for p in WORLDS.glob("*.toml")))
        raise MissingFile(f"{name_or_path}: no such world file; worlds that come with the package: {names}")
    if path.stat().st_size > LARGEST_FILE:
        raise FileFormatError(f"{path}: has {path.stat().st_size} bytes, at most {LARGEST_FILE} are read")
    try:
        return parse_world(path.read_text(encoding="utf-8"), str(path))
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: not a TOML file ({error})") from None


def parse_world(text: str, source: str) -> World:
    """A world from the text of a file; `source` is its name for messages.

    Raises:
        FileFormatError: see `load_world`.
    """
    try:
        data: dict[str, Any] = parse_toml(text)
    except ValueError as error:
        raise FileFormatError(f"{source}: not a TOML file ({error})") from None
    lines = _lines(text)
    top = {key: value for key, value in data.items() if key not in KINDS and key != LIGHT}
    options = _options(World, top, source, lines.get(("", 0), {}), "a world")
    options[LIGHT] = _light(data.get(LIGHT, {}), source, lines.get((LIGHT, 0), {}))
    features: list[tuple[int, AnyFeature]] = []
    for kind, cls in KINDS.items():
        entries = data.get(kind, [])
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            raise FileFormatError(f"{source}, line {lines[('', 0)].get(kind, 1)}: write [[{kind}]] for each {kind}")
        for number, entry in enumerate(entries):
            key_lines = lines.get((kind, number), {})
            first = key_lines.get("", 1)
            known = _options(cls, entry, source, key_lines, f"a {kind}")
            try:
                features.append((first, cls(**known)))
            except InvalidInput as error:
                line = key_lines.get(str(error).split(" ", 1)[0], first)
                raise FileFormatError(f"{source}, line {line}: [[{kind}]]: {error}") from None
    features.sort(key=lambda item: item[0])
    try:
        bare = World(**options)
    except InvalidInput as error:
        line = lines[("", 0)].get(str(error).split(" ", 1)[0], 1)
        raise FileFormatError(f"{source}, line {line}: {error}") from None
    for line, feature in features:
        try:
            bare.check_inside(feature)
        except InvalidInput as error:
            raise FileFormatError(f"{source}, line {line}: {error}") from None
    return World(**options, features=tuple(feature for _, feature in features))


def _light(strengths: Any, source: str, lines: Mapping[str, int]) -> Light:
    """The light of a world from its table."""
    if not isinstance(strengths, dict):
        raise FileFormatError(f"{source}: write [light], and below it an effect and its strength in each line")
    for name, strength in strengths.items():
        where = f"{source}, line {lines.get(name, lines.get('', 1))}"
        _value(strength, "float", f"{where}: {name}")
        try:
            real_light({name: strength})
        except InvalidInput as error:
            raise FileFormatError(f"{where}: [light]: {error}") from None
    return real_light(strengths)


def _lines(text: str) -> dict[tuple[str, int], dict[str, int]]:
    """Line of every key, by (name of the table, its number among those of that name); its own line under the key ""."""
    found: dict[tuple[str, int], dict[str, int]] = {("", 0): {}}
    counts: dict[str, int] = {}
    table = ("", 0)
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _TABLE.match(line):
            name = header.group(1)
            table = (name, counts.get(name, 0))
            counts[name] = table[1] + 1
            found[table] = {"": number}
        elif key := _KEY.match(line):
            found[table].setdefault(key.group(1), number)
    for (name, number), keys in list(found.items()):
        if name and number == 0:
            found[("", 0)].setdefault(name, keys[""])
    return found


def _options(
    cls: type[Any], entry: Mapping[str, Any], source: str, lines: Mapping[str, int], what: str
) -> dict[str, Any]:
    """Keyword arguments of a dataclass from a table, types checked."""
    fields = {f.name: f for f in dataclasses.fields(cls) if f.init and f.name not in ("features", LIGHT)}
    result: dict[str, Any] = {}
    for key, value in entry.items():
        where = f"{source}, line {lines.get(key, lines.get('', 1))}"
        if key not in fields:
            extra = f"; tables: {', '.join(KINDS)}, {LIGHT}" if cls is World else ""
            raise FileFormatError(f"{where}: unknown key {key!r}; {what} has: {', '.join(fields)}{extra}")
        result[key] = _value(value, str(fields[key].type), f"{where}: {key}")
    for name, f in fields.items():
        if name not in result and f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING:
            raise FileFormatError(f"{source}, line {lines.get('', 1)}: {name!r} is missing; {what} needs it")
    return result


def _value(value: Any, kind: str, where: str) -> Any:
    def is_number(item: Any) -> bool:
        return isinstance(item, int | float) and not isinstance(item, bool)

    if kind == "float" and is_number(value):
        return float(value)
    if kind == "int" and isinstance(value, int) and not isinstance(value, bool):
        return value
    if kind == "str" and isinstance(value, str):
        return value
    if kind.startswith("tuple") and isinstance(value, list) and len(value) == 2 and all(map(is_number, value)):
        return float(value[0]), float(value[1])
    raise FileFormatError(f"{where} is {value!r}, it must be {_TYPES[kind]}")
