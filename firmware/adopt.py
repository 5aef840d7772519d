"""Compares a build with the committed firmware and, if the same compiler made both, replaces the committed one.

`python adopt.py BUILD.uf2 COMPILER_VERSION [--adopt]`; `--adopt` also when the compilers differ.
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
COMMITTED = HERE / "guara_board.uf2"
COMPILER = HERE / "COMPILER"


def adopt(build: Path, version: str, always: bool) -> str:
    """Return the result of the build, in one line of text."""
    made_by = COMPILER.read_text().strip() if COMPILER.exists() else "nobody"
    if version != made_by and not always:
        return (
            f"{COMMITTED.name} was made by {made_by}, this build by {version}: bytes were not compared, "
            f"the build is {build}"
        )
    if COMMITTED.exists() and COMMITTED.read_bytes() == build.read_bytes():
        return f"{COMMITTED.name}: the same bytes as committed"
    COMMITTED.write_bytes(build.read_bytes())
    COMPILER.write_text(version + "\n")
    return f"{COMMITTED.name}: replaced by the new build"


if __name__ == "__main__":
    sys.stdout.write(adopt(Path(sys.argv[1]), sys.argv[2], "--adopt" in sys.argv) + "\n")
