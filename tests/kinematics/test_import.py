"""Importing the package is cheap until a robot is loaded."""

import subprocess
import sys

import pytest


@pytest.mark.slow
def test_import_leaves_pinocchio_alone() -> None:
    """Importing the package does not import Pinocchio; loading a robot does."""
    code = (
        "import sys, kinematics; assert 'pinocchio' not in sys.modules; "
        "kinematics.load_robot('guara'); assert 'pinocchio' in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_nothing_is_imported_from_above() -> None:
    """No module of the package imports a package beside or above it."""
    code = (
        "import sys, pkgutil, importlib, kinematics\n"
        "for module in pkgutil.iter_modules(kinematics.__path__, 'kinematics.'): importlib.import_module(module.name)\n"
        "bad = {'guara_perception', 'drivers', 'transport', 'pinocchio', 'cv2', 'scipy'} & set(sys.modules)\n"
        "assert not bad, bad"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
