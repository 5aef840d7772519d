"""Prints the drivers' figures: what a scan costs beyond its frames, and how soon the laser is off.

    python -m benchmarks.drivers

An emulated board and a free-running emulated camera: 1280 x 1024 pixels, 30 frames per second, 8 ms exposure, 8 ms from
exposure to arrival. For the scans a USB transfer takes 1 ms, as at full speed; how soon the laser is off is measured
with a board in another process, without that delay. The driver and pyusb are the real ones.
"""

from __future__ import annotations

import resource
import signal
import statistics
import subprocess
import sys
import time

import numpy as np

from drivers import AcquireOptions, CameraSettings, LaserBoard, OffFrames, acquire, measure_lag, prepare
from drivers.emulator import EmulatedBoard, EmulatedCamera, EmulatorConfig, ExposureView, emulated_backend
from testbed.remote_board import RemoteBoard, remote_backend

FPS = 30.0
FIRING_ORDER = [(index, -0.146 + 0.473 * index / 69) for index in range(70)]
# How often each figure is measured.
SCANS, KILLS, EXCEPTIONS = 5, 5, 20

# Processor time spent on pictures so far [s].
rendering = 0.0


def make_render() -> object:
    """A renderer of a noisy floor and one red row, quick enough that a scan waits for its frames, not for pictures."""
    rng = np.random.default_rng(0)
    floor = rng.normal(60, 3, (1024, 1280, 3)).clip(0, 255).astype(np.uint8)
    dark = rng.normal(60, 3, (1024, 1280, 3)).clip(0, 255).astype(np.uint8)

    def render(view: ExposureView, settings: CameraSettings) -> np.ndarray:
        global rendering
        if view.laser_fraction == 0:
            return dark
        begun = time.thread_time()
        image = floor.copy()
        row = round(150 + (view.mirror_angle + 0.146) * 1500)
        image[row - 3 : row + 4, :, 2] = 60 + int(150 * view.laser_fraction)
        rendering += time.thread_time() - begun
        return image

    return render


def processor_seconds() -> float:
    """Processor time of this process so far [s], without that of making pictures."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime - rendering


def scans() -> None:
    """Print the time of whole scans against that of their frames."""
    emulated = EmulatedBoard(EmulatorConfig(bus_delay=0.001))
    render = make_render()
    with (
        LaserBoard(backend=emulated_backend(emulated)) as board,
        EmulatedCamera(emulated, render, fps=FPS) as camera,  # type: ignore[arg-type]
    ):
        for off in (OffFrames.ONE, OffFrames.NONE, OffFrames.PER_STRIPE):
            frames = {OffFrames.ONE: 71, OffFrames.NONE: 70, OffFrames.PER_STRIPE: 140}[off]
            durations, processor, skipped, all_in_step = [], [], 0, True
            for _ in range(SCANS):
                prepare(board, FIRING_ORDER)
                begun, used = time.monotonic(), processor_seconds()
                with acquire(board, camera, FIRING_ORDER, AcquireOptions(off=off)) as stripes:
                    for _ in stripes:
                        pass
                    durations.append(time.monotonic() - begun)
                    processor.append(processor_seconds() - used)
                skipped += stripes.report.frames_skipped
                all_in_step &= stripes.report.in_step
            frame_time = frames / FPS
            worst, median = max(durations), statistics.median(durations)
            print(
                f"scan of 70 stripes, off frames {off.value:10s}: frames need {frame_time:.3f} s, median "
                f"{median:.3f} s ({median / frame_time - 1:+.1%}), worst of {SCANS} "
                f"{worst:.3f} s ({worst / frame_time - 1:+.1%}, goal <= 5 %), in step: {all_in_step}, frames skipped "
                f"{skipped / SCANS:.1f} a scan, processor {statistics.median(processor) * 1e3:.0f} ms without rendering"
            )
        board.go_to_angle(0.1)
        measured = measure_lag(board, camera)
        print(f"camera's lag measured: {measured.lag * 1e3:.1f} ms (-{measured.uncertainty * 1e3:.1f}), true 16.0 ms")


HOST = """
import sys
from drivers import LaserBoard
from testbed.remote_board import remote_backend
with LaserBoard(backend=remote_backend(sys.argv[1])) as board:
    board.laser_on()
    print("on", flush=True)
    while True:
        board.status()
"""


def kills() -> None:
    """Print how long the laser stays on after its host was killed, seen from a third process."""
    emulator = subprocess.Popen(
        [sys.executable, "-m", "testbed.remote_board"], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    assert emulator.stdout is not None
    address = emulator.stdout.readline().split()[1]
    remote = RemoteBoard(address)
    for ending in (signal.SIGKILL, signal.SIGTERM):
        times = []
        for _ in range(KILLS):
            host = subprocess.Popen([sys.executable, "-c", HOST, address], stdout=subprocess.PIPE, text=True)
            assert host.stdout is not None
            host.stdout.readline()
            time.sleep(0.6)
            assert remote.view().laser_on
            begun = time.monotonic()
            host.send_signal(ending)
            while remote.view().laser_on and time.monotonic() - begun < 10:
                time.sleep(0.002)
            times.append(time.monotonic() - begun)
            host.wait()
        goal = "goal <= 0.6 s" if ending is signal.SIGKILL else "no goal"
        print(f"laser off after {ending.name} of the host: median {statistics.median(times):.3f} s, worst of {KILLS} "
              f"{max(times):.3f} s ({goal})")  # fmt: skip
    exceptions(address)
    emulator.terminate()
    emulator.wait()


def exceptions(address: str) -> None:
    """Print how long the laser stays on after an exception in the caller's loop over stripes."""
    render = make_render()
    remote = RemoteBoard(address)
    times = []
    with LaserBoard(backend=remote_backend(address)) as board:
        with EmulatedCamera(remote, render, fps=FPS) as camera:  # type: ignore[arg-type]
            prepare(board, FIRING_ORDER)
            for number in range(EXCEPTIONS):
                raised = 0.0
                try:
                    with acquire(board, camera, FIRING_ORDER, AcquireOptions(off=OffFrames.ONE)) as stripes:
                        for stripe in stripes:
                            # At another stripe and another phase of the frame each time.
                            if stripe.index == 2 + number % 5:
                                time.sleep(0.0016 * number)
                                raised = time.monotonic()
                                raise ZeroDivisionError
                except ZeroDivisionError:
                    view = remote.view()
                times.append(view.laser_since - raised)
                assert not view.laser_on
    print(
        f"laser off after an exception in the loop: median {statistics.median(times) * 1e3:.1f} ms, "
        f"worst of {EXCEPTIONS} {max(times) * 1e3:.1f} ms (goal <= 50 ms)"
    )


def main() -> None:
    """Command line."""
    scans()
    kills()


if __name__ == "__main__":
    main()
