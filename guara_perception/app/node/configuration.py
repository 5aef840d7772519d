"""Configuration of a node: check of its files before the start, and monitor of changes while the node runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from guara_perception.app.devices_file import load_devices
from guara_perception.app.node.devices import choose_rig
from guara_perception.app.options import DeviceOptions
from guara_perception.calibration.file import load_calibration
from guara_perception.exceptions import PerceptionError
from kinematics import KinematicsError, load_robot
from transport import Health, SecurityError, StatusItem, TransportError
from transport.security.certificates import judge_security

EXPECTED = (PerceptionError, KinematicsError, TransportError, OSError)


def mistakes_of(
    chosen: DeviceOptions,
    *,
    simulated: bool,
    security: Path | None,
    world: str = "demo",
    options: Iterable[Callable[[], object]] = (),
) -> list[str]:
    """Find the mistakes in robot, calibration, devices.toml, security folder and options without opening a device.

    Parts that do not fit together are reported only if each part is valid.

    Args:
        chosen: robot, calibration and devices.
        simulated: True for a simulated robot and devices.
        security: folder of the node's role, or None.
        world: name or file of the simulated world.
        options: checks of further options, each of which raises an error that names a mistake.
    """
    parts: tuple[tuple[Any, Callable[[str], object]], ...] = (
        (chosen.robot, load_robot),
        (chosen.calibration, load_calibration),
        (chosen.devices, load_devices),
        (security, _refuse_unsafe),
    )
    mistakes = [_mistake(load, str(given)) for given, load in parts if given is not None]
    if not any(mistakes):
        # The parts are valid, but may not fit together.
        mistakes.append(_mistake(partial(choose_rig, simulated=simulated, on_the_move=True, world=world), chosen))
    mistakes += [_mistake(lambda check: check(), option) for option in options]
    return list(filter(None, mistakes))


def _mistake(load: Callable[[Any], object], given: object) -> str:
    try:
        load(given)
    except EXPECTED as error:
        return str(error)
    return ""


def _refuse_unsafe(folder: str) -> None:
    level, message = judge_security(folder)
    if level is Health.ERROR:
        raise SecurityError(f"{folder}: {message}")


class ConfigurationWatch:
    """Monitor of the configuration files of a running node. A change takes effect only after a restart."""

    def __init__(self, *paths: Path | None) -> None:
        """Store the current state of the given files and of all files in the given folders; None is skipped."""
        self._paths = [path for path in paths if path is not None]
        self._before = self._state()

    def item(self) -> StatusItem:
        """Status item of the configuration: a warning if files have changed since the start."""
        now = self._state()
        changed = sorted(
            str(path) for path in now.keys() | self._before.keys() if now.get(path) != self._before.get(path)
        )
        level, message = Health.OK, "unchanged since the start"
        if changed:
            level = Health.WARN
            message = f"changed since the start; restart the node to apply the changes: {', '.join(changed)}"
        return StatusItem(name="configuration", level=level, message=message)

    def _state(self) -> dict[Path, tuple[int, int]]:
        files = [file for path in self._paths for file in (path.rglob("*") if path.is_dir() else [path])]
        state = {}
        for file in files:
            try:
                status = file.stat()
            except OSError:
                continue
            if not file.is_dir():
                state[file] = (status.st_mtime_ns, status.st_size)
        return state
