"""`python -m benchmarks` lists the programs; `python -m benchmarks NAME ...` runs one, as `benchmarks.NAME` does."""

from __future__ import annotations

import ast
import importlib
import sys
from pathlib import Path

ENDING = '\n\nif __name__ == "__main__":\n    main()\n'


def programs() -> dict[str, str]:
    """First line of the docstring of each module that ends in a call of its `main`, by name."""
    texts = {path.stem: path.read_text() for path in sorted(Path(__file__).parent.glob("[a-z]*.py"))}
    docs = {name: ast.get_docstring(ast.parse(text)) or "" for name, text in texts.items() if text.endswith(ENDING)}
    return {name: doc.split("\n")[0] for name, doc in docs.items()}


def main() -> None:
    """Command line."""
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    known = programs()
    if name in ("-h", "--help"):
        print("\n".join(f"{program:<16} {first_line}" for program, first_line in known.items()))
        return
    if name not in known:
        sys.exit(f"benchmarks: no program {name!r}; allowed: {', '.join(known)}")
    del sys.argv[1]
    sys.argv[0] = f"benchmarks {name}"
    importlib.import_module(f"benchmarks.{name}").main()


if __name__ == "__main__":
    main()
