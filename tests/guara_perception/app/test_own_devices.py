"""Scan with user-defined camera and board classes in a file beside devices.toml."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.exit_codes import EXIT_BAD_INPUT, EXIT_CALIBRATION
from guara_perception.app.main import run
from guara_perception.simulation.specimen import specimen
from kinematics import RobotModel
from tests.ports import free_endpoint

# The board forwards eight members of another board, so that the scan can use no others.
OWN = """
from pathlib import Path

import guara_perception as gp
from drivers import Board, LaserBoard
from drivers.emulator import EmulatedBoard, emulated_backend
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.simulated_camera import simulated_camera
from guara_perception.simulation.walk import simulate_walk
from guara_perception.simulation.world import load_world

robot, world = gp.load_robot("guara"), load_world("demo")
calibration = gp.load_calibration(Path(__file__).with_name("calibration.json"))
scene = SimulatedRangefinder(world, calibration, robot)
pause = next(simulate_walk(world, robot, cycles=0))
scene.set_pose(pause.transform_base_to_world, pause.joint_positions)
emulated = EmulatedBoard()


def Eye():
    return simulated_camera(scene, emulated, fps=60.0, latency=0.001)


class Arm(Board):
    def __init__(self):
        self.within = LaserBoard(backend=emulated_backend(emulated))

    identity = property(lambda self: self.within.identity)
    open = lambda self: self.within.open()
    close = lambda self: self.within.close()
    status = lambda self: self.within.status()
    laser_on = lambda self: self.within.laser_on()
    laser_off = lambda self: self.within.laser_off()
    home = lambda self: self.within.home()
    go_to_step = lambda self, step, *, wait=True: self.within.go_to_step(step, wait=wait)
"""


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_scan_by_devices_of_ones_own(tmp_path: Path, robot: RobotModel, capsys: pytest.CaptureFixture[str]) -> None:
    """`guara scan --devices` finds both and makes a grid."""
    rig = tmp_path / "rig"
    rig.mkdir()
    (rig / "own_rig.py").write_text(OWN)
    made = specimen(robot, (320, 256), 0)

    def save(identity: str) -> gp.Calibration:
        camera = replace(made.camera, identity=identity)
        return gp.save_calibration(replace(made, camera=camera), rig / "calibration.json")

    calibration = save("emulated camera, serial EMU0001")
    (rig / "devices.toml").write_text(
        'format = "guara-devices/1"\n[camera]\nsource = "own_rig:Eye"\n[board]\nsource = "own_rig:Arm"\n'
    )
    arguments = ["-c", str(rig / "calibration.json"), "--devices", str(rig / "devices.toml"), "--mode", "coarse"]
    assert run(["scan", str(tmp_path / "scan"), *arguments]) == 0, capsys.readouterr().err
    scan = gp.open_scan(tmp_path / "scan")
    terrain = gp.process_scan(scan, calibration, robot)
    assert scan.camera_identity == "emulated camera, serial EMU0001"
    assert len(scan.stripes) == 35 and np.isfinite(terrain.elevation).mean() > 0.7
    # The calibration of another camera of the same kind.
    save("emulated camera, serial EMU0002")
    refusal = "camera 'emulated camera, serial EMU0001', but the calibrated camera is 'emulated camera"
    assert run(["convert", str(tmp_path / "scan"), str(tmp_path / "scan.mcap")]) == 0
    for words, code in (
        (["scan", str(tmp_path / "refused"), *arguments], EXIT_BAD_INPUT),
        (["process", str(tmp_path / "scan"), "-o", str(tmp_path / "t.npz"), *arguments[:2]], EXIT_BAD_INPUT),
        (["process", str(tmp_path / "scan.mcap"), "-o", str(tmp_path / "t.npz"), *arguments[:2]], EXIT_BAD_INPUT),
        (["run", *arguments[:4], "--listen", free_endpoint()], EXIT_CALIBRATION),
    ):
        assert run(words) == code
        assert refusal in capsys.readouterr().err
