"""The package as a whole: cost of its import, relations of its errors, and its documentation."""

import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import drivers
from drivers import errors
from drivers.board.usb_link import udev_rule

ROOT = Path(drivers.__file__).resolve().parents[1]


@pytest.mark.slow
def test_importing_loads_neither_device_library_nor_a_package_above() -> None:
    """`import drivers` works without pyusb, libusb and OpenCV, and imports no neighbouring package."""
    program = (
        "import sys, drivers; "
        "print([name for name in ('usb', 'cv2', 'libusb_package', 'scipy', 'kinematics', 'transport', "
        "'guara_perception') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.strip() == "[]"


def test_every_error_is_a_driver_error_and_a_builtin() -> None:
    """A caller that does not import this package can catch built-in exceptions."""
    kinds = [kind for _, kind in inspect.getmembers(errors, inspect.isclass)]
    for kind in set(kinds) - {errors.DriverError}:
        assert issubclass(kind, errors.DriverError)
        builtins = [base for base in kind.__mro__ if base.__module__ == "builtins" and base is not object]
        assert builtins[0] not in (Exception, BaseException), kind


def test_every_error_and_verdict_stands_in_the_page() -> None:
    """docs/drivers.md explains each of them, and contains the udev rule."""
    page = (ROOT / "docs" / "drivers.md").read_text()
    roots = {"DriverError", "BoardError", "CameraError", "AcquisitionError"}
    for name, _ in inspect.getmembers(errors, inspect.isclass):
        assert name in roots or f"`{name}`" in page, name
    for verdict in drivers.StripeVerdict:
        assert f"`{verdict.name}`" in page
    assert udev_rule() in page
