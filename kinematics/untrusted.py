"""Parsers of XML and TOML from untrusted sources, with limits on file size and on the nesting of TOML.

Robot files may come from anywhere, even over the network as part of a grid. XML entities and files far larger than
those of any robot are rejected.
"""

from __future__ import annotations

import math
import re
import tomllib
import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path
from xml.parsers import expat

from kinematics.exceptions import RobotFileError

# Largest XML file that is read [bytes]. The URDF of the stock robot guara is 31 kB long.
LARGEST_XML = 16 * 1024 * 1024
# Largest TOML file that is read [characters]. The robot.toml of the stock robot guara is 6,500 long.
LARGEST_FILE = 1024 * 1024
# Largest number of parts of a dotted key, and greatest depth of nested tables and lists.
DEEPEST = 16
BETWEEN_KEYS = re.compile(r"[,=\[\]{}#]")
BRACKET = re.compile(r"[\[\]{}]")
# Lines that open a table or set a key. Only bare names are recognised, because robot files use no others.
HEADER = re.compile(r"\s*\[+\s*([\w.\-]+)\s*\]")
KEY = re.compile(r"\s*([\w.\-]+)\s*=")


class Element(ElementTree.Element):
    """XML element with the line on which it begins."""

    line = 0


def read_xml(path: Path) -> tuple[Element, str]:
    """Parse an XML file; return the root element and the text of the file.

    Raises:
        RobotFileError: the file cannot be read, is too large, not UTF-8 or not XML, or defines entities.
    """
    try:
        if path.stat().st_size > LARGEST_XML:
            raise RobotFileError(f"{path}: has {path.stat().st_size} bytes; at most {LARGEST_XML} are read")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise RobotFileError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise RobotFileError(f"{path}: is not UTF-8: {error}") from error
    return parse_xml(text, path), text


def parse_xml(text: str, path: Path) -> Element:
    """Parse an XML text; return the root element. `path` is used in messages.

    Raises:
        RobotFileError: the text is not XML, or defines entities.
    """
    # The text was read as UTF-8. The encoding that it declares is ignored, since Python may not know it.
    parser = expat.ParserCreate("utf-8")
    builder = ElementTree.TreeBuilder(element_factory=Element)

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = builder.start(tag, attributes)
        assert isinstance(element, Element)
        element.line = parser.CurrentLineNumber

    def entity(name: str, *_: object) -> None:
        raise RobotFileError(f"{path}:{parser.CurrentLineNumber}: entity {name!r} is defined; entities are not read")

    parser.StartElementHandler = start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.EntityDeclHandler = entity
    try:
        # A lone surrogate, which UTF-8 does not have, becomes bytes that expat refuses.
        parser.Parse(text.encode("utf-8", "surrogatepass"), True)
    except expat.ExpatError as error:
        raise RobotFileError(f"{path}: is not valid XML: {error}") from error
    root = builder.close()
    assert isinstance(root, Element)
    return root


def finite_numbers(text: str) -> tuple[float, ...]:
    """Parse finite numbers separated by spaces; empty if the text contains anything else."""
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        return ()
    return values if all(map(math.isfinite, values)) else ()


def parse_toml(text: str) -> dict[str, object]:
    """Parse a TOML text.

    Raises:
        ValueError: the text is not TOML, or is nested deeper than DEEPEST. Dots and brackets in strings and comments
            also count as nesting.
    """
    # The depth is counted in one pass, because a malicious text could make a regular expression backtrack for hours.
    for line in text.splitlines():
        for part in BETWEEN_KEYS.split(line):
            if part.count(".") >= DEEPEST:
                raise ValueError(f"a key of more than {DEEPEST} parts: {part.strip()[:40]}...")
    depth = 0
    for bracket in BRACKET.finditer(text):
        depth = max(0, depth + (1 if bracket.group() in "[{" else -1))
        if depth > DEEPEST:
            raise ValueError(f"tables or lists more than {DEEPEST} deep")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError(f"tables or lists more than {DEEPEST} deep") from None


def key_lines(text: str) -> dict[str, int]:
    """Map the dotted name of each table (`table_name`) and key to the line of its first occurrence, for messages."""
    lines: dict[str, int] = {}
    counts: Counter[str] = Counter()
    table = ""
    for number, line in enumerate(text.splitlines(), 1):
        if header := HEADER.match(line):
            counts[header.group(1)] += 1
            table = table_name(header.group(1), counts[header.group(1)])
            lines.setdefault(table, number)
        elif key := KEY.match(line):
            lines.setdefault(f"{table}.{key.group(1)}" if table else key.group(1), number)
    return lines


def table_name(name: str, number: int) -> str:
    """Name used by `key_lines` for a table of an array of tables [[name]]; `number` counts from 1."""
    return name if number == 1 else f"{name}#{number}"
