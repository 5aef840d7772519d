"""Devices of a live command, real or simulated."""

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


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Robot and devices of a live command.

    Attributes:
        robot: model of the robot.
        known_calibration: calibration of the rangefinder; None for a scan to calibrate with.
        rangefinder: board and camera, not yet open.
        simulation: simulated robot behind the rangefinder, None for real devices.
    """

    robot: RobotModel
    known_calibration: Calibration | None
    rangefinder: Rangefinder
    simulation: SimulatedRobot | None

    @property
    def calibration(self) -> Calibration:
        """The calibration; `choose_rig` made sure that there is one where it is needed.

        Raises:
            InvalidInput: there is none.
        """
        if self.known_calibration is None:
            raise InvalidInput("no calibration: give -c calibration.json (`guara calibrate` makes it)")
        return self.known_calibration


def choose_rig(
    chosen: DeviceOptions,
    *,
    simulated: bool,
    needs_calibration: bool = True,
    on_the_move: bool = False,
    world: str = "demo",
) -> Rig:
    """Make the rig that the options of a command name.

    Args:
        chosen: devices as the options name them.
        simulated: True for a simulated robot, world and devices.
        needs_calibration: False for a scan to calibrate with.
        on_the_move: True if feet will be placed by the grids; the keys of robot.toml that concern safety must then be
            measured.
        world: name or file of the simulated world.

    Raises:
        InvalidInput: neither a calibration nor a simulation; a simulation with devices; a real robot on assumed values.
        CalibrationMismatch: devices and calibration are of different cameras.
        MissingFile, FileFormatError: calibration, file of devices or world cannot be read.
        kinematics.KinematicsError: the robot cannot be loaded.
    """
    if simulated:
        if chosen.devices is not None:
            raise InvalidInput("--simulated brings its own devices: leave --devices out")
        from guara_perception.app.node.simulated import SimulatedRobot
        from guara_perception.simulation.world import load_world

        made = SimulatedRobot(chosen.robot or "guara", chosen.calibration, world=load_world(world))
        return Rig(made.robot, made.calibration, made.rangefinder, made)
    devices = devices_of(
        chosen.devices, camera=chosen.camera, trigger=chosen.trigger, fps=chosen.fps, off_frames=chosen.off_frames
    )
    if not needs_calibration:
        return Rig(load_robot(chosen.robot or "guara"), None, rangefinder_of(devices), None)
    if chosen.calibration is None:
        raise InvalidInput("no calibration: give -c calibration.json (`guara calibrate` makes it), or --simulated")
    calibration = load_calibration(chosen.calibration)
    model = load_robot(chosen.robot or calibration.robot)
    if on_the_move:
        _refuse_assumed(model)
    calibrated = calibration.camera
    check_identity(devices.identity, calibrated.identity, str(chosen.devices))
    devices = replace(devices, size=calibrated.size, identity=calibrated.identity or devices.identity)
    return Rig(model, calibration, rangefinder_of(devices), None)


# Tables and keys of robot.toml that footholds depend on. The mounts of camera and laser are not among them: the
# calibration, without which there is no live scan, overrides them.
SAFETY_KEYS = ("sole", "legs.", "traversability.", "heights.")


def _refuse_assumed(robot: RobotModel) -> None:
    """Refuse a robot with assumed, not measured, soles or limits."""
    open_keys = [key for key in robot.config.assumed if key.startswith(SAFETY_KEYS)]
    if open_keys:
        raise InvalidInput(
            f"{robot.config.path}: {', '.join(open_keys)} of {robot.name!r} not measured, and footholds depend on it: "
            "measure as the table [assumed] says and delete the lines there; --simulated needs none of them"
        )


def rangefinder_of(devices: Devices, *, free: bool = False) -> Rangefinder:
    """Board and camera of a file of devices, not yet open; the camera's settings are locked when it is opened.

    Args:
        devices: devices as their file names them.
        free: run the camera freely although it has a trigger, for instance for images of a checkerboard.

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
