"""Triggered and free-running sweeps against the bound of the motion; detection of faulty triggers.

`python -m benchmarks.sweeps [--json]`. Emulated devices in emulated time: seconds of sweeps are the devices' own, and
the host is taken to be quick; only the work on the pictures is measured, as processor time of this machine.
"""

from __future__ import annotations

import itertools
import json
import time

import numpy as np

from benchmarks.command import Table, options
from drivers import AcquireOptions, StripeCapture, SweepOptions
from guara_perception.app.messages import terrain_to_message
from guara_perception.app.node.live_scan import STRIPES_AFTER
from testbed import scenes
from testbed.emulated_sweeps import (
    FLASH,
    Triggered,
    emulated,
    free_running,
    take,
    triggered,
    triggered_on_chip,
    view_of,
)
from testbed.faulty_triggers import faults
from testbed.triggered_camera import EmulatedTriggeredCamera
from transport.messages.terrain_message import encode_terrain

STRIPES = (35, 70)
RATES = (30, 60, 120, 200)
SIZE, FAULTY_SWEEPS = (640, 512), 200
BOARD = "emulated board, 7 rad/s at once"
Times = tuple[float, float, float, float]


def end_to_end(scan: scenes.ScanInMemory) -> Times:
    """Times of a scan whose stripes arrive in emulated time and are processed one by one on this machine.

    Returns:
        Time from the first trigger to the encoded grid, and from the last frame; median processor time of a stripe, and
        processor time after the last stripe, for finishing the grid and encoding it [s].
    """
    angles = {stripe.index: stripe.mirror_angle for stripe in scan.calibration.stripes}
    firing_order = [(index, angles[index]) for index, _, _ in scan.frames]
    with emulated() as (board, driver):
        board.shutter.wired = True
        camera = EmulatedTriggeredCamera(board, board.shutter, view_of(scan))
        taken = take(driver, camera, firing_order, AcquireOptions(sweep=SweepOptions(flash=FLASH)))
        begun = board.triggers()[0]
    return min(_worked_on(scan, taken, begun) for _ in range(3))


def _worked_on(scan: scenes.ScanInMemory, taken: list[StripeCapture], begun: float) -> Times:
    processor = scan.processor()
    free, spent = 0.0, []
    for number, stripe in enumerate(taken, 1):
        assert stripe.on is not None
        before = time.process_time()
        processor.add(stripe.index, stripe.on, stripe.off)
        spent.append(time.process_time() - before)
        free = max(free, stripe.on_stamp) + spent[-1]
        if number == len(taken) - STRIPES_AFTER:
            # As `live_scan` does.
            before = time.process_time()
            processor.work_ahead()
            free += time.process_time() - before
    before = time.process_time()
    encode_terrain(terrain_to_message(processor.finish(), robot="guara", sequence=0))
    after = time.process_time() - before
    last = max(stripe.on_stamp for stripe in taken)
    return free + after - begun, free + after - last, float(np.median(spent)), after


def by_rate() -> list[dict[str, float]]:
    """Free-running and triggered sweeps with cameras of each rate, beside the bound; returns the free-running ones."""
    print(f"sweeps by emulated time [s], {1e3 * FLASH:g} ms of light; triggered by the emulated board")
    table = Table(
        "stripes:d | frames/s:d | free-running:.3f | triggered:.3f | bound of move, settle and flash:.3f | proved:d"
    )
    free: list[dict[str, float]] = []
    for stripes, fps in itertools.product(STRIPES, RATES):
        seconds, row = free_running(fps, stripes), triggered(stripes, FLASH, fps)
        free.append({"fps": fps, "stripes": stripes, "seconds": round(seconds, 4)})
        table.row(stripes, fps, seconds, row.seconds, row.bound, row.proved)
    return free


def by_light() -> Triggered:
    """Triggered sweeps beside their bound, by the emulated board and by the firmware.

    Returns:
        The sweep of 70 stripes with 4 ms of light each, by the emulated board.
    """
    from testbed.chip import ChipMissing

    table = Table("triggered by:<35 | stripes:d | light ms:g | sweep s:.3f | of the bound:.2f | bound s:.3f | proved:d")
    found: dict[tuple[str, int, float], Triggered] = {}
    devices = {BOARD: triggered, "firmware on its chip, with its ramp": triggered_on_chip}
    try:
        for name, stripes, flash in itertools.product(devices, STRIPES, (0.002, FLASH)):
            row = found[name, stripes, flash] = devices[name](stripes, flash)
            table.row(name, stripes, 1e3 * flash, row.seconds, row.seconds / row.bound, row.bound, row.proved)
    except ChipMissing as missing:
        print(missing)
    return found[BOARD, STRIPES[-1], FLASH]


def measure(faulty_sweeps: int = FAULTY_SWEEPS) -> dict[str, object]:
    """Everything; returns what `--json` prints."""
    standard, free = by_light(), by_rate()
    seconds, tail, per_stripe, after = end_to_end(scenes.simulated(SIZE, 70))
    print(
        f"first trigger to encoded grid {seconds:.3f} s: {1e3 * tail:.1f} ms after the last frame; "
        f"{1e3 * per_stripe:.2f} ms of processor time a stripe, {1e3 * after:.1f} ms for the grid"
    )
    counts = faults(faulty_sweeps)
    print(
        f"{counts['sweeps']} sweeps with triggers missed, doubled, late: {counts['injected']} injected, "
        f"{counts['found']} found, {counts['wrong_stripes']} wrong stripes"
    )
    return {
        "triggered": {
            "stripes": standard.stripes,
            "flash_s": standard.flash,
            "seconds": round(standard.seconds, 4),
            "bound_s": round(standard.bound, 4),
            "proved": standard.proved,
            "end_to_end_s": round(seconds, 4),
        },
        "free_running": free,
        "faults": counts,
    }


def main() -> None:
    """Command line."""
    asked = options(__doc__, json=(False, "print all figures as one JSON object in the last line"))
    figures = measure()
    if asked.json:
        print(json.dumps(figures))


if __name__ == "__main__":
    main()
