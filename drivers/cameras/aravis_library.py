"""Finds Aravis, the library of GigE Vision and USB3 Vision cameras, through its GObject introspection."""

from __future__ import annotations

import importlib
import importlib.machinery
import importlib.util
import sys
from types import ModuleType
from typing import Any

from drivers.errors import CameraBackendMissing

API = "0.8"
# Where Debian and Ubuntu put `gi`; a virtual environment does not see it.
SYSTEM_PACKAGES = ("/usr/lib/python3/dist-packages",)
INSTALL = f"apt install gir1.2-aravis-{API} python3-gi"


def load_aravis() -> Any:
    """Return the module `Aravis`.

    `gi` is taken from the environment where it is, otherwise the system's; nothing else of the system's packages
    becomes visible.

    Raises:
        CameraBackendMissing: it is not installed, or not for this Python.
    """
    _import_gi().require_version("Aravis", API)
    return importlib.import_module("gi.repository.Aravis")


def glib_error() -> type[Exception]:
    """Return the type of the errors that Aravis raises; `load_aravis` must have been called."""
    error: type[Exception] = importlib.import_module("gi.repository.GLib").Error
    return error


def _import_gi() -> Any:
    try:
        gi = importlib.import_module("gi")
    except ImportError:
        gi = _import_system_gi()
    try:
        gi.require_version("Aravis", API)
    except ValueError as error:
        raise CameraBackendMissing(f"Aravis is not installed ({error}): {INSTALL}") from None
    return gi


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
            f"the system's python3-gi is not for this Python {version} ({error}): make the environment with the "
            "system's python3 (`make PYTHON=/usr/bin/python3 install`), or `pip install 'PyGObject<3.51'` in it"
        ) from None
    return module
