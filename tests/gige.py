"""A fake GigE Vision camera for tests; skips where Aravis is not installed."""

from __future__ import annotations

import fcntl
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.cameras.aravis_library import load_aravis
from drivers.errors import CameraBackendMissing
from testbed.gige import FakeGigeCamera

# GigE Vision has one port, and loopback one address: two tests at once would take it from one another.
LOCK = Path(tempfile.gettempdir()) / "guara-fake-gige-camera.lock"


@contextmanager
def alone_with_aravis() -> Iterator[None]:
    """No other test has a fake camera while the block lasts; skips without Aravis."""
    try:
        load_aravis()
    except CameraBackendMissing as missing:
        pytest.skip(str(missing))
    with LOCK.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@contextmanager
def fake_gige(size: tuple[int, int] = (320, 256), lost_packets: float = 0.0) -> Iterator[FakeGigeCamera]:
    """The camera, alone on loopback while the block lasts."""
    with alone_with_aravis(), FakeGigeCamera(size=size, lost_packets=lost_packets) as camera:
        yield camera
