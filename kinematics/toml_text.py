"""Reads TOML; files that could hold up or overflow the standard library's parser are refused first."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

# [byte] Far above any real file: the largest robot.toml or world file of this repository has 8 kB.
LARGEST_FILE = 1024 * 1024
# Most parts of a dotted key, and deepest nesting of tables or lists.
DEEPEST = 16

BETWEEN_KEYS = re.compile(r"[,=\[\]{}#]")
BRACKET = re.compile(r"[\[\]{}]")
# A line that opens a table, and one that gives a key: bare names, as the files of robots have them.
HEADER = re.compile(r"\s*\[+\s*([\w.\-]+)\s*\]")
KEY = re.compile(r"\s*([\w.\-]+)\s*=")


def read_toml(path: Path) -> dict[str, object]:
    """The content of a TOML file.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file is no TOML, is larger than LARGEST_FILE, or is nested deeper than DEEPEST.
    """
    if path.stat().st_size > LARGEST_FILE:
        raise ValueError(f"{path.stat().st_size} bytes; at most {LARGEST_FILE} are read")
    return parse_toml(path.read_text(encoding="utf-8"))


def parse_toml(text: str) -> dict[str, object]:
    """The content of a TOML text; ValueError as in `read_toml`."""
    # Depth is counted in one pass: a regular expression that looks for it can be made to backtrack for hours.
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
    """Dotted name of each table and key -> the line on which it first stands; for messages."""
    lines: dict[str, int] = {}
    table = ""
    for number, line in enumerate(text.splitlines(), 1):
        if header := HEADER.match(line):
            table = header.group(1)
            lines.setdefault(table, number)
        elif key := KEY.match(line):
            lines.setdefault(f"{table}.{key.group(1)}" if table else key.group(1), number)
    return lines
