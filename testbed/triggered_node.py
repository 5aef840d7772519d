"""`guara run` with the firmware on the emulated chip, which triggers a fake GigE Vision camera.

`python -m testbed.triggered_node FOLDER --listen tcp/127.0.0.1:7447` starts the node and prints one JSON object for
each scan. Light, chip, motor and camera sensor are emulated; everything else is as on a robot: firmware binary, pyusb
and driver, GigE Vision packets, Aravis, node and Zenoh. The chip's time is stopped while an image is rendered and sent.
The lens is assumed to be opened so far that a short exposure is as bright as 8 ms otherwise.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import guara_perception as gp
from drivers import CameraSettings, StripeCapture
from drivers.board import usb_link
from drivers.cameras.aravis_camera import AravisCamera
from drivers.emulator import EmulatedBackend
from drivers.sweep.acquisition import StripeStream
from guara_perception.app.devices_file import Devices, save_devices
from guara_perception.app.main import run
from guara_perception.app.messages import terrain_to_message
from guara_perception.app.node import published_scans
from guara_perception.app.node.live_scan import STRIPES_AFTER
from guara_perception.app.node.simulated import DEMO_WORLD
from guara_perception.calibration.file import save_calibration
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.simulated_camera import NOMINAL_EXPOSURE_S, renderer
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.walk import simulate_walk
from guara_perception.simulation.world import load_world
from testbed.bench_board.shutter import Opening
from testbed.chip import Chip, ChipBus, ChipClock, Wiring, load_firmware
from testbed.gige import FakeGigeCamera
from transport.messages.terrain_message import encode_terrain

FIRMWARE = Path(__file__).resolve().parents[1] / "firmware" / "guara_board.uf2"
# Images of 80 kB fit into a socket's buffer, so that a busy machine loses no packets.
SIZE = (320, 256)
FLASH = 0.004
# Data rate of a gigabit link [byte/s], and its latency [s].
LINK, LATENCY = 117e6, 0.0005
# Offset [s] and drift of the camera's clock.
CLOCK_OFFSET, CLOCK_DRIFT = 1234.5, 2e-5
# Longest wait for packets on loopback [s].
PATIENCE = 20.0
# Number of measurements of the work, of which the fastest is used, because other load only slows it down.
TRIES = 5
Group = tuple[StripeCapture, ...]


@dataclass(frozen=True, slots=True)
class TriggeredScan:
    """Timing of a scan, from its first trigger to the encoded grid.

    Attributes:
        stripes: number of requested stripes.
        proved: number of stripes whose frames were verified.
        repeated: number of triggers in addition to one for each stripe, one for each dark flash, and one for the off
            frame.
        sweep: time from the first trigger to the arrival of the last frame, in the chip's time [s].
        work: processor time from the frames to the encoded grid [s].
        seconds: time from the first trigger to the encoded grid [s], computed from the arrivals of frames in the chip's
            time and the processor time of each group of frames.
        after: part of `seconds` after the arrival of the last frame [s].
        counted: True if the board counted the exposures.
        mono: True if all frames have one channel.
    """

    stripes: int
    proved: int
    repeated: int
    sweep: float
    work: float
    seconds: float
    after: float
    counted: bool
    mono: bool


class TriggeredRig:
    """Chip, fake camera and scene, with all times on the chip's clock."""

    def __init__(self, fake: FakeGigeCamera, calibration: gp.Calibration, flash: float, *, wired: bool = True) -> None:
        """Connect camera, chip and scene.

        Args:
            fake: the camera, on loopback.
            calibration: calibration of the simulated rangefinder.
            flash: exposure time of the camera [s].
            wired: True = the camera's EXPOSURE_ACTIVE is connected to the board.
        """
        robot = gp.load_robot("guara")
        world = load_world(DEMO_WORLD)
        self.scene = SimulatedRangefinder(world, calibration, robot)
        self.pause = next(simulate_walk(world, robot, cycles=0))
        self.scene.set_pose(self.pause.transform_base_to_world, self.pause.joint_positions)
        wiring = Wiring(transfer=LATENCY + calibration.camera.size[0] * calibration.camera.size[1] / LINK)
        wiring.shutter.wired, wiring.shutter.exposure = wired, flash
        wiring.on_picture = self._picture
        self.chip = Chip(load_firmware(FIRMWARE), wiring)
        self.bus = ChipBus(self.chip)
        # Read here, because reading runs the chip, which is not allowed within one of its alarms.
        _ = self.chip.identity
        self._fake, self._wired = fake, wired
        self._draw = renderer(self.scene)
        self.camera: AravisCamera | None = None
        self._groups: list[Group] = []
        self._first_trigger = 0

    def note_groups(
        self, groups: Callable[[StripeStream], Iterator[Group]]
    ) -> Callable[[StripeStream], Iterator[Group]]:
        """Wrap `StripeStream.groups` to store the groups for the measurement."""

        def noted(stream: StripeStream) -> Iterator[Group]:
            self._groups.clear()
            self._first_trigger = len(self.chip.world.triggers)
            for group in groups(stream):
                self._groups.append(group)
                yield group

        return noted

    def note_publishing(self, publish: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap `send_terrain` to print the figures of the scan afterwards."""

        def noted(*args: Any, **keywords: Any) -> Any:
            message = publish(*args, **keywords)
            if self._groups:
                print(json.dumps(asdict(self._measured())), flush=True)
                self._groups.clear()
            return message

        return noted

    def note_camera(self, opened: Callable[[AravisCamera], None]) -> Callable[[AravisCamera], None]:
        """Wrap `AravisCamera.open` to store the camera, so that `_picture` can wait for its packets."""

        def noted(camera: AravisCamera) -> None:
            opened(camera)
            self.camera = camera

        return noted

    def _measured(self) -> TriggeredScan:
        captures = [capture for group in self._groups for capture in group]
        triggers = np.array(self.chip.world.triggers[self._first_trigger :]) / 1e9
        last = max(_arrival(group) for group in self._groups)
        end, work = min(self._work_again() for _ in range(TRIES))
        return TriggeredScan(
            stripes=len(captures),
            proved=sum(capture.on is not None and capture.verdict.in_step for capture in captures),
            repeated=len(triggers) - len(captures) - sum(capture.is_dark_due for capture in captures) - 1,
            sweep=last - float(triggers[0]),
            work=work,
            seconds=end - float(triggers[0]),
            after=end - last,
            counted=self._wired and self._fake.state.shows_exposure,
            mono=all(capture.on is not None and capture.on.ndim == 2 for capture in captures),
        )

    def _work_again(self) -> tuple[float, float]:
        """Process the same frames again without the emulated chip, whose processor time would be measured too.

        Returns:
            Time at which the grid is encoded, in the chip's time [s], and processor time of the work [s].
        """
        processor = gp.ScanProcessor(self.scene.calibration, self.scene.robot, self.pause.stance, "standard")
        free = work = 0.0
        left, is_ahead = sum(map(len, self._groups)), False
        for group in self._groups:
            before = time.thread_time()
            pairs = [gp.FramePair(c.index, c.on, c.off) for c in group if c.on is not None and c.verdict.in_step]
            if pairs:
                processor.add_all(pairs)
            left -= len(group)
            if 0 < left <= STRIPES_AFTER and not is_ahead:
                # As `live_scan` does.
                is_ahead = True
                processor.work_ahead()
            spent = time.thread_time() - before
            free, work = max(free, _arrival(group)) + spent, work + spent
        before = time.thread_time()
        encode_terrain(terrain_to_message(processor.finish(), robot="guara", sequence=0))
        spent = time.thread_time() - before
        return free + spent, work + spent

    def _picture(self, opening: Opening) -> None:
        """Render the image of an exposure and send it; the chip waits for its arrival."""
        start, end = opening
        # With the assumed lens, a short exposure is as bright as the nominal exposure of the simulation.
        picture = self._draw(self.chip.exposure(start, end), CameraSettings(exposure=NOMINAL_EXPOSURE_S, gain=1.0))
        if self.camera is None:
            return
        before = self.camera.waiting
        if not self._fake.expose(picture, CLOCK_OFFSET + start * (1.0 + CLOCK_DRIFT)):
            return
        until = time.monotonic() + PATIENCE
        while self.camera.waiting == before and time.monotonic() < until:
            time.sleep(0.0002)


def _arrival(group: Group) -> float:
    return max(capture.on_stamp or 0.0 for capture in group)


def serve(folder: Path, listen: str, *, flash: float, size: tuple[int, int], wired: bool, arguments: list[str]) -> int:
    """Run the node until it is stopped; return its exit code.

    Args:
        folder: folder in which calibration.json and devices.toml are written.
        listen: endpoint of the node.
        flash: exposure time of the camera and duration of the laser flash [s].
        size: width and height of the images [px].
        wired: True = EXPOSURE_ACTIVE is connected.
        arguments: further arguments of `guara run`.
    """
    calibration = specimen(gp.load_robot("guara"), size)
    save_calibration(calibration, folder / "calibration.json")
    fake = FakeGigeCamera(size=size)
    output = "Line2" if wired else None
    devices = Devices(f"aravis:{fake.name}", settings={"exposure": flash}, trigger="Line1", exposure_output=output)
    save_devices(devices, folder / "devices.toml")
    with ExitStack() as stack:
        rig = TriggeredRig(stack.enter_context(fake), calibration, flash, wired=wired)
        stack.enter_context(ChipClock(rig.bus))
        for owner, name, changed in (
            (usb_link, "default_backend", lambda: EmulatedBackend(rig.bus)),
            (StripeStream, "groups", rig.note_groups(StripeStream.groups)),
            (AravisCamera, "open", rig.note_camera(AravisCamera.open)),
            (published_scans, "send_terrain", rig.note_publishing(published_scans.send_terrain)),
        ):
            setattr(owner, name, changed)
        files = ["-c", str(folder / "calibration.json"), "--devices", str(folder / "devices.toml")]
        return run(["run", *files, "--mode", "standard", "--listen", listen, *arguments])


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m testbed.triggered_node", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder for calibration.json and devices.toml")
    parser.add_argument("--listen", required=True, help="endpoint of the node")
    parser.add_argument("--flash", type=float, default=FLASH, help="duration of the flash of each stripe [s]")
    parser.add_argument("--size", type=int, nargs=2, default=SIZE, help="width and height of the images [px]")
    parser.add_argument("--unwired", action="store_true", help="EXPOSURE_ACTIVE is not connected")
    known, rest = parser.parse_known_args()
    raise SystemExit(
        serve(
            known.folder,
            known.listen,
            flash=known.flash,
            size=(known.size[0], known.size[1]),
            wired=not known.unwired,
            arguments=rest,
        )
    )


if __name__ == "__main__":
    main()
