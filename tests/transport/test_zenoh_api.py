"""Tests of the parts of Zenoh that may change."""

import operator
import sys

import pytest

from transport import zenoh_api

# Names below `zenoh` that `transport.zenoh_api` uses and that Zenoh marks unstable.
UNSTABLE = ("handlers.Callback", "Publisher.id", "Publisher.matching_status", "SourceInfo", "SessionInfo.links")


@pytest.mark.parametrize("name", UNSTABLE)
def test_unstable_names_are_there(name: str) -> None:
    """The installed Zenoh has every name that its makers mark unstable and that is used here."""
    import zenoh
    import zenoh.handlers

    assert operator.attrgetter(name)(zenoh) is not None


def test_error_text_drops_the_lines_of_the_source() -> None:
    """A user sees the cause, not where Zenoh was built."""
    text = "Unable to connect!  at /home/x/.cargo/a.rs:1."
    assert zenoh_api.error_text(RuntimeError(text)) == "Unable to connect!"


@pytest.mark.slow
def test_importing_transport_imports_no_heavy_library() -> None:
    """Zenoh, rosbags, mcap and cryptography are imported when first used, not before."""
    import subprocess

    code = (
        "import sys, transport, transport.recording; "
        "print([m for m in ('zenoh', 'rosbags', 'mcap', 'cryptography') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
