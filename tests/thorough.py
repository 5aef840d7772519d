"""How many examples a test tries: a third while somebody waits, all in `make test-all` and so in CI."""

import os

IS_THOROUGH = os.environ.get("THOROUGH") == "1"


def examples(number: int) -> int:
    """As many of this number as are tried now, two at least."""
    return number if IS_THOROUGH else max(number // 3, 2)
