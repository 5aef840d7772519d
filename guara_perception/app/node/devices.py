"""Robot and devices, real or simulated, of a command that scans."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from drivers import AcquireOptions, OffFrames
from guara_perception.app.devices_file import Devices, devices_of
from guara_perception.app.node.rangefinder import STRIPES_TOGETHER, Rangefinder
from guara_perception.app.options import DeviceOptions
from guara_perception.calibration.calibration import Calibration, check_identity
from guara_perception.calibration.file import load_calibration
from guara_perception.exceptions import InvalidInput
from kinematics import RobotModel, load_robot

if TYPE_CHECKING:
    from guara_perception.app.node.simulated import SimulatedRobot
    from guara_perception.simulation.world import World


# Keys and prefixes of keys of robot.toml on which footholds depend. The mounts of camera and laser are not among them,
# because the calibration overrides them.
SAFETY_KEYS = ("sole", "legs.", "traversability.", "heights.")
NO_CALIBRATION = "no calibration: give -c calibration.json, as written by `guara calibrate`"


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Robot and devices of a command that scans.

    Attributes:
        robot: model of the robot.
        known_calibration: calibration of the rangefinder; None for a scan from which to calibrate.
        rangefinder: laser board and camera, not yet open.
        simulation: simulated robot to which the rangefinder belongs; None for real devices.
    """

    robot: RobotModel
    known_calibration: Calibration | None
    rangefinder: Rangefinder
    simulation: SimulatedRobot | None

    @property
    def calibration(self) -> Calibration:
        """Calibration of the rangefinder.

        Raises:
            InvalidInput: there is no calibration; `choose_rig` raises this first for commands that require one.
        """
        if self.known_calibration is None:
            raise InvalidInput(NO_CALIBRATION)
        return self.known_calibration


def choose_rig(
    chosen: DeviceOptions,
    *,
    simulated: bool,
    needs_calibration: bool = True,
    on_the_move: bool = False,
    world: str | World = "demo",
) -> Rig:
    """Create robot and devices as selected by the options of a command.

    Args:
        chosen: robot, calibration and devices given by the options.
        simulated: True for a simulated robot, world and devices.
        needs_calibration: False for a scan from which to calibrate.
        on_the_move: True if footholds will be chosen from the grids; no safety-related value of robot.toml may then be
            assumed.
        world: the simulated world, or its name or file.

    Raises:
        InvalidInput: a calibration is required but not given, `simulated` is combined with devices.toml, safety-related
            values of a real robot are assumed and `on_the_move` is True, or a device cannot be created (see
            `rangefinder_of`).
        CalibrationMismatch: devices and calibration belong to different cameras, or the calibration does not belong to
            the simulated robot.
        MissingFile, FileFormatError: calibration, devices.toml or world cannot be read.
        kinematics.KinematicsError: the robot cannot be loaded.
    """
    if simulated:
        if chosen.devices is not None:
            raise InvalidInput("--simulated has its own devices: leave --devices out")
        from guara_perception.app.node.simulated import SimulatedRobot

        made = SimulatedRobot(robot_of(chosen), chosen.calibration, world=world)
        return Rig(made.robot, made.calibration, made.rangefinder, made)
    devices = devices_of(chosen)
    if not needs_calibration:
        return Rig(load_robot(chosen.robot or "guara"), None, rangefinder_of(devices), None)
    if chosen.calibration is None:
        raise InvalidInput(f"{NO_CALIBRATION}, or --simulated")
    calibration = load_calibration(chosen.calibration)
    model = load_robot(chosen.robot or calibration.robot)
    if on_the_move:
        _refuse_assumed(model)
    calibrated = calibration.camera
    check_identity(devices.identity, calibrated.identity, str(chosen.devices))
    devices = replace(devices, size=calibrated.size, identity=calibrated.identity or devices.identity)
    return Rig(model, calibration, rangefinder_of(devices), None)


def robot_of(chosen: DeviceOptions) -> str:
    """Name or folder of the robot that the options select.

    Raises:
        MissingFile, FileFormatError: the calibration cannot be read.
    """
    if chosen.robot is None and chosen.calibration is not None:
        return load_calibration(chosen.calibration).robot
    return chosen.robot or "guara"


def _refuse_assumed(robot: RobotModel) -> None:
    """Reject a robot with assumed (not measured) values on which footholds depend.

    Raises:
        InvalidInput: a safety-related value is assumed.
    """
    open_keys = [key for key in robot.config.assumed if key.startswith(SAFETY_KEYS)]
    if open_keys:
        raise InvalidInput(
            f"{robot.config.path}: {', '.join(open_keys)} of {robot.name!r} are assumed, not measured, but footholds "
            "depend on them: measure them as the table [assumed] says, then delete their lines there (not needed "
            "with --simulated)"
        )


def rangefinder_of(devices: Devices, *, free: bool = False) -> Rangefinder:
    """Create the rangefinder described by devices.toml without opening it.

    When it is opened, the camera is locked to the settings in devices.toml, if any. A triggered camera is always locked
    to an exposure.

    Args:
        devices: contents of devices.toml.
        free: use a free-running camera even if a trigger is given, for instance for images of a checkerboard.

    Raises:
        InvalidInput: see `Devices.camera`, `Devices.laser_board` and `Devices.sweep_options`.
    """
    sweep = None if free else devices.sweep_options()
    return Rangefinder(
        board=devices.laser_board(),
        camera=devices.camera(free=free),
        options=AcquireOptions(off=OffFrames(devices.off_frames), together=STRIPES_TOGETHER, sweep=sweep),
        settings=devices.camera_settings() if devices.settings or sweep is not None else None,
        identity=devices.identity,
    )
