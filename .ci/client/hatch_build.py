"""Build hook of the distribution `guara-client`, and the list of its files.

The client is what the modules in ROOTS import when they are imported, and the data beside it. All else belongs to
`guara-perception`, whose hook leaves these files out of its wheel.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOTS = (
    "guara_perception.all_errors",
    "guara_perception.app.client",
    "guara_perception.terrain.file",
    "guara_perception.terrain.grid",
)
# Endings of files of data.
SUFFIXES = ("", ".md", ".mplstyle", ".msg", ".pyi", ".typed")
PACKAGES = ("guara_perception", "kinematics", "transport", "drivers")


def client_files(checkout: Path) -> list[str]:
    """Files of the client, as paths from the checkout."""
    modules = {_name(path.relative_to(checkout)): path for top in PACKAGES for path in (checkout / top).rglob("*.py")}
    found: set[str] = set()
    left = list(ROOTS)
    while left:
        name = left.pop()
        if name in modules and name not in found:
            found.add(name)
            # A module is imported after the packages that it is in.
            left += [name.rpartition(".")[0], *_imported(ast.parse(modules[name].read_text(encoding="utf-8")).body)]
    files = {modules[name] for name in found}
    folders = {path.parent for path in files if path.name == "__init__.py"}
    for top in PACKAGES:
        for path in (checkout / top).rglob("*"):
            is_data = path.is_file() and path.suffix in SUFFIXES and path.name[0] != "."
            if is_data and _package(path) in folders:
                files.add(path)
    return sorted(path.relative_to(checkout).as_posix() for path in files)


def _name(path: Path) -> str:
    """Name under which a file is imported."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _package(path: Path) -> Path:
    """Folder of the package that a file lies in."""
    return next(folder for folder in path.parents if (folder / "__init__.py").is_file())


def _imported(body: list[ast.stmt]) -> Iterator[str]:
    """Names that the statements of a module import: not those in functions, for type checkers alone, or tried."""
    for node in body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
            yield str(node.module)


class ClientHook(BuildHookInterface):
    """Puts the client's files, which lie two folders up, into its wheel and its source distribution."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Name the files; in an unpacked source distribution they are in place."""
        if not Path(self.root, "PKG-INFO").exists():
            checkout = Path(self.root).parents[1]
            build_data["force_include"] |= {str(checkout / name): name for name in client_files(checkout)}
