"""How much a test tries: some examples and cases while somebody waits, all of them in `make test-all` and so in CI."""

import os
from collections.abc import Sequence
from typing import Any

import pytest

IS_THOROUGH = os.environ.get("THOROUGH") == "1"


def examples(number: int) -> int:
    """As many of this number as are tried now, two at least."""
    return number if IS_THOROUGH else max(number // 3, 2)


def further(*cases: Any) -> Sequence[Any]:
    """Costly cases beside another one of the same test that shows the same: `heavy`, so tried in CI."""
    return [pytest.param(case, marks=pytest.mark.heavy) for case in cases]
