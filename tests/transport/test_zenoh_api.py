"""Tests of the parts of Zenoh that may change."""

import sys

import pytest

from transport import zenoh_api


def test_all_unstable_names_are_there() -> None:
    """The installed Zenoh has every name that its makers mark unstable and that is used here."""
    assert zenoh_api.missing_names() == ()


def test_a_missing_name_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The check would notice a name that went away."""
    import zenoh

    monkeypatch.delattr(zenoh.handlers, "Callback")
    assert zenoh_api.missing_names() == ("handlers.Callback",)


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
