"""Triggered and free-running sweeps against the bound of the motion; detection of faulty triggers.

`python -m benchmarks.sweeps [--json]`. Emulated devices in emulated time: seconds of sweeps are the devices' own, and
the host is taken to be quick; only the work on the pictures is measured, as processor time of this machine.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import numpy as np

from benchmarks.command import options
from benchmarks.section import Section
from benchmarks.sweep_faults import FAULTY_SWEEPS, faults
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
from testbed.triggered_camera import EmulatedTriggeredCamera
from transport.messages.terrain_message import encode_terrain

STRIPES = (35, 70)
RATES = (30, 60, 120, 200)
SIZE = (640, 512)
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


def by_rate(say: Callable[[str], object] = print) -> list[dict[str, float]]:
    """Free-running and triggered sweeps with cameras of each rate, beside the bound; returns the free-running ones."""
    say(f"sweeps by emulated time [s], {1e3 * FLASH:g} ms of light; triggered by the emulated board (7 rad/s at once)")
    say("stripes  frames/s  free-running  triggered  bound of move, settle and flash  proved")
    free: list[dict[str, float]] = []
    for stripes in STRIPES:
        for fps in RATES:
            seconds, row = free_running(fps, stripes), triggered(stripes, FLASH, fps)
            free.append({"fps": fps, "stripes": stripes, "seconds": round(seconds, 4)})
            say(
                f"{stripes:7d}  {fps:8d}  {seconds:12.3f}  {row.seconds:9.3f}  {row.bound:31.3f}  "
                f"{row.proved} of {stripes}"
            )
    return free


def by_light(say: Callable[[str], object] = print) -> list[Triggered]:
    """Triggered sweeps beside their bound, by the emulated board, which are returned, and by the firmware's ramp."""
    from testbed.chip import ChipMissing

    rows: dict[str, list[Triggered]] = {}
    for name, sweep in (
        ("emulated board, 7 rad/s at once", triggered),
        ("firmware on its chip, with its ramp", triggered_on_chip),
    ):
        try:
            rows[name] = [sweep(stripes, flash) for stripes in STRIPES for flash in (0.002, FLASH)]
        except ChipMissing as missing:
            say(str(missing))
        for row in rows.get(name, ()):
            say(
                f"{name}: {row.stripes} stripes at {1e3 * row.flash:g} ms of light in {row.seconds:.3f} s, "
                f"{row.seconds / row.bound:.2f} of the bound {row.bound:.3f} s; {row.proved} of {row.stripes} proved"
            )
    return next(iter(rows.values()))


def measure(say: Callable[[str], object] = print, faulty_sweeps: int = FAULTY_SWEEPS) -> dict[str, object]:
    """Everything; returns what `--json` prints."""
    rows = by_light(say)
    free = by_rate(say)
    seconds, tail, per_stripe, after = end_to_end(scenes.simulated(SIZE, 70))
    say(
        f"first trigger to encoded grid {seconds:.3f} s: {1e3 * tail:.1f} ms after the last frame; "
        f"{1e3 * per_stripe:.2f} ms of processor time a stripe, {1e3 * after:.1f} ms for the grid"
    )
    counts = faults(faulty_sweeps)
    say(
        f"{counts['sweeps']} sweeps with triggers missed, doubled, late: {counts['injected']} injected, "
        f"{counts['found']} found, {counts['wrong_stripes']} wrong stripes"
    )
    standard = rows[-1]
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


def section(faulty_sweeps: int) -> Section:
    """The table for the suite."""
    lines: list[str] = []
    measure(lines.append, faulty_sweeps)
    description = "Emulated devices in emulated time; processor time for the work on pictures. The chip is emulated."
    return Section("sweeps", "Sweeps", description, "what was found:", [(line,) for line in lines])


def main() -> None:
    """Command line."""
    asked = options(__doc__, json=(False, "print all figures as one JSON object in the last line"))
    figures = measure()
    if asked.json:
        print(json.dumps(figures))


if __name__ == "__main__":
    main()
