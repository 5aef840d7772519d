"""Reads an XML file into elements that know their line; what can only harm is refused before it is read.

A robot's files may come from anywhere, and with a grid over the network: no entity is expanded, and no file larger than
any robot's is opened.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from xml.parsers import expat

from kinematics.exceptions import RobotFileError

# [byte] The largest stock URDF known has 70 kB.
LARGEST_FILE = 16 * 1024 * 1024


class Element(ElementTree.Element):
    """An element of XML with the line on which it begins."""

    line = 0


def read_xml(path: Path) -> tuple[Element, str]:
    """The outermost element of a file, and its text.

    Raises:
        RobotFileError: the file is missing, too large, not UTF-8, no XML, or defines entities.
    """
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise RobotFileError(f"{path}: has {path.stat().st_size} bytes; at most {LARGEST_FILE} are read")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise RobotFileError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise RobotFileError(f"{path}: is not valid XML: {error}") from error
    return parse_xml(text, path), text


def parse_xml(text: str, path: Path) -> Element:
    """The outermost element of a text; `path` is for messages. Errors as in `read_xml`."""
    # The text was read as UTF-8, whatever encoding it declares: Python may not know that one.
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
        parser.Parse(text.encode("utf-8"), True)
    except expat.ExpatError as error:
        raise RobotFileError(f"{path}: is not valid XML: {error}") from error
    root = builder.close()
    assert isinstance(root, Element)
    return root
