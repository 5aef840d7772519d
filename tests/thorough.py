"""How much a test tries: some examples and cases while somebody waits, all of them in `make test-all` and so in CI."""

import os
from collections.abc import Sequence
from typing import Any

import pytest

IS_THOROUGH = os.environ.get("THOROUGH") == "1"


def examples(number: int) -> int:
    """How many examples to try now: this number, or, while somebody waits, a fifth of it, but three at least."""
    return number if IS_THOROUGH else max(number // 5, min(number, 3))


def further(*cases: Any) -> Sequence[Any]:
    """Costly further cases of a test, which has a cheaper one: `heavy`, so tried in CI."""
    return [pytest.param(case, marks=pytest.mark.heavy) for case in cases]
