"""Access to Aravis, a library for GigE Vision and USB3 Vision cameras, and search for such cameras."""

from __future__ import annotations

import importlib
import importlib.machinery
import importlib.util
import sys
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from drivers.errors import CameraBackendMissing, CameraNotFound

API = "0.8"
# Location of the package `gi` in Debian and Ubuntu; virtual environments do not include it.
SYSTEM_PACKAGES = ("/usr/lib/python3/dist-packages",)
# Aravis's names for the attributes of `AravisDevice`, in their order.
DEVICE_FIELDS = ("id", "vendor", "model", "serial_nbr", "address", "protocol")
INSTALL = f"apt install gir1.2-aravis-{API} python3-gi"


def load_aravis() -> Any:
    """Import and return the module `Aravis`.

    The package `gi` is imported from the environment or, if it is missing there, from the system, without making other
    system packages visible.

    Raises:
        CameraBackendMissing: Aravis or `gi` is not installed, or `gi` is built for another Python version.
    """
    try:
        gi = importlib.import_module("gi")
    except ImportError:
        gi = _import_system_gi()
    try:
        gi.require_version("Aravis", API)
    except ValueError as error:
        raise CameraBackendMissing(f"Aravis is not installed ({error}): {INSTALL}") from None
    return importlib.import_module("gi.repository.Aravis")


def glib_error() -> type[Exception]:
    """Return the exception type of Aravis errors; `load_aravis` must have been called."""
    error: type[Exception] = importlib.import_module("gi.repository.GLib").Error
    return error


def _import_system_gi() -> ModuleType:
    spec = importlib.machinery.PathFinder.find_spec("gi", list(SYSTEM_PACKAGES))
    if spec is None or spec.loader is None:
        raise CameraBackendMissing(
            f"GigE Vision and USB3 Vision cameras need Aravis, which is not installed: {INSTALL}"
        )
    module = importlib.util.module_from_spec(spec)
    sys.modules["gi"] = module
    try:
        spec.loader.exec_module(module)
    except ImportError as error:
        del sys.modules["gi"]
        version = ".".join(map(str, sys.version_info[:2]))
        raise CameraBackendMissing(
            f"the system's python3-gi is not for this Python {version} ({error}): create the virtual environment with "
            "the system's python3 (`make PYTHON=/usr/bin/python3 install`), or run `pip install 'PyGObject<3.51'` in it"
        ) from None
    return module


@dataclass(frozen=True, slots=True)
class AravisDevice:
    """Camera found by Aravis.

    Attributes:
        name: name to pass to `AravisCamera`.
        maker, model, serial: as reported by the camera; empty if not reported.
        address: address of the camera on the network or bus.
        protocol: such as "GigEVision" or "USB3Vision".
    """

    name: str
    maker: str
    model: str
    serial: str
    address: str
    protocol: str


def find_aravis_cameras() -> tuple[AravisDevice, ...]:
    """Search for cameras on all network interfaces and on USB. The search takes about a second.

    Raises:
        CameraBackendMissing: Aravis cannot be loaded; see `load_aravis`.
    """
    aravis = load_aravis()
    aravis.update_device_list()
    return tuple(
        AravisDevice(*(getattr(aravis, f"get_device_{field}")(number) or "" for field in DEVICE_FIELDS))
        for number in range(aravis.get_n_devices())
    )


def trigger_lines(name: str) -> tuple[str, ...]:
    """List the input lines that can trigger a camera, such as "Line1".

    Args:
        name: name of the camera, as returned by `find_aravis_cameras`.

    Raises:
        CameraBackendMissing: Aravis cannot be loaded; see `load_aravis`.
        CameraNotFound: the camera does not respond, or another program uses it.
    """
    aravis = load_aravis()
    try:
        sources = aravis.Camera.new(name).dup_available_trigger_sources()
    except glib_error() as error:
        raise CameraNotFound(f"camera {name} does not respond ({error}); another program may be using it") from None
    return tuple(source for source in sources if source.startswith("Line"))
