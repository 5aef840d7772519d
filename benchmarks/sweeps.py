"""The sweep: triggered by the board and free-running, against the bound of its motion; faults of the trigger, found.

`python -m benchmarks.sweeps [--json]`. Emulated devices in emulated time: seconds of sweeps are the devices' own, and
the host is taken to be quick; only the work on the pictures is measured, as processor time of this machine.
"""

from __future__ import annotations

import argparse
import json
import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.section import Section
from drivers import (
    AcquireOptions,
    BoardConfig,
    Image,
    LaserBoard,
    StripeCapture,
    SweepOptions,
    acquire,
    prepare,
    timing,
)
from drivers.camera import Camera, CameraSettings
from drivers.emulator import (
    EmulatedBackend,
    EmulatedBoard,
    EmulatedCamera,
    EmulatedClock,
    EmulatedTriggeredCamera,
    EmulatorConfig,
    ExposureView,
    emulated_backend,
)
from tests import scenes

FLASH = 0.004
STRIPES = (35, 70)
RATES = (30, 60, 120, 200)
FAULTY_SWEEPS = 200
# Seconds that a transfer takes on a full-speed bus, for the emulated board.
BUS_DELAY = 0.0003
SIZE = (640, 512)
FIRMWARE = Path(__file__).resolve().parents[1] / "firmware" / "guara_board.uf2"
SLOWER = 3
# Seconds within which an opening is on time for a trigger: half of the tolerance of `SweepOptions`, and clocks' drift.
ON_TIME = 0.0005 + 0.0001


def pattern_of(stripes: int) -> list[tuple[int, float]]:
    """The standard pattern, or every second stripe of it."""
    every = 70 // stripes
    return [(index, -0.14 + 0.46 * index / 69) for index in range(0, 70, every)]


class Picture:
    """A small picture with one row of laser; its first two pixels number the exposure."""

    def __init__(self, board: EmulatedBoard | None = None) -> None:
        """Number the exposures of `board`, if one is given."""
        self._board = board
        self._number = 0

    def __call__(self, view: ExposureView, settings: CameraSettings) -> Image:
        """Draw an exposure."""
        image = np.full((256, 80, 3), 40, np.uint8)
        if view.laser_fraction > 0.2:
            row = 20 + round((view.mirror_angle + 0.15) * 400)
            image[max(0, row - 1) : row + 2, :, 2] = 200
        if self._board is not None:
            starts = [opening[0] for opening in self._board.openings(self._number)]
            self._number += starts.index(view.start)
            image[0, :2, 0] = divmod(self._number, 256)
        return image


@contextmanager
def emulated(config: EmulatorConfig | None = None) -> Iterator[tuple[EmulatedBoard, LaserBoard]]:
    """An emulated board in emulated time, with the driver on it."""
    with timing.on_clock(EmulatedClock()):
        board = EmulatedBoard(config or EmulatorConfig(bus_delay=BUS_DELAY))
        with LaserBoard(BoardConfig(handle_signals=False), backend=emulated_backend(board)) as driver:
            yield board, driver


def bound_of(driver: LaserBoard, pattern: list[tuple[int, float]], flash: float) -> float:
    """What moves, settling and flashes take by the board's own account of its motion [s]."""
    profile = driver.motion_profile()
    steps = [driver.step_at(angle) for _, angle in pattern]
    moves = sum(profile.time(after - here) for here, after in zip(steps, steps[1:], strict=False))
    return moves + len(steps) * (profile.settle + flash)


def take(
    driver: LaserBoard, camera: Camera, pattern: list[tuple[int, float]], options: AcquireOptions
) -> list[StripeCapture]:
    """One scan, from the first stripe's place."""
    prepare(driver, pattern)
    with camera, acquire(driver, camera, pattern, options) as stripes:
        return list(stripes)


@dataclass(frozen=True, slots=True)
class Triggered:
    """A triggered sweep: seconds from the first trigger to the end of the last flash, its bound, proved stripes."""

    stripes: int
    flash: float
    seconds: float
    bound: float
    proved: int


def triggered(stripes: int, flash: float = FLASH, fps: float = 0.0) -> Triggered:
    """Sweep with the emulated board in Python and a camera of at most `fps` frames per second; 0 for any."""
    pattern = pattern_of(stripes)
    with emulated() as (board, driver):
        board.shutter.wired, board.shutter.exposure = True, flash
        camera = EmulatedTriggeredCamera(board, board.shutter, Picture(), fps=fps)
        taken = take(driver, camera, pattern, AcquireOptions(sweep=SweepOptions(flash=flash)))
        bound = bound_of(driver, pattern, flash)
        return _result(stripes, flash, np.array(board.triggers()), bound, taken)


def triggered_on_chip(stripes: int, flash: float = FLASH) -> Triggered:
    """The same with the firmware on the emulated chip, and its ramp; needs the extra `firmware`."""
    from drivers.emulator.chip import Chip, ChipBus, ChipClock, load_firmware

    pattern = pattern_of(stripes)
    chip = Chip(load_firmware(FIRMWARE))
    chip.wiring.shutter.wired, chip.wiring.shutter.exposure = True, flash
    chip.rewire()
    bus = ChipBus(chip)
    with (
        ChipClock(bus),
        LaserBoard(BoardConfig(handle_signals=False), backend=EmulatedBackend(bus)) as driver,
    ):
        camera = EmulatedTriggeredCamera(bus, chip.wiring.shutter, Picture())
        taken = take(driver, camera, pattern, AcquireOptions(sweep=SweepOptions(flash=flash)))
        return _result(stripes, flash, np.array(chip.world.triggers) / 1e9, bound_of(driver, pattern, flash), taken)


def _result(stripes: int, flash: float, triggers: np.ndarray, bound: float, taken: list[StripeCapture]) -> Triggered:
    proved = sum(stripe.on is not None and stripe.verdict.in_step for stripe in taken)
    return Triggered(stripes, flash, float(triggers[-1] - triggers[0] + flash), bound, proved)


def free_running(fps: int, stripes: int) -> float:
    """Seconds from the first command to the last frame with a camera that runs freely."""
    pattern = pattern_of(stripes)
    exposure = min(0.008, 0.4 / fps)
    with emulated() as (board, driver):
        camera = EmulatedCamera(board, Picture(), fps=fps, exposure=exposure, latency=exposure)
        prepare(driver, pattern)
        with camera, acquire(driver, camera, pattern) as stripes_taken:
            count = sum(1 for _ in stripes_taken)
        assert count == stripes
        return stripes_taken.report.duration


@dataclass(frozen=True, slots=True)
class Faults:
    """Triggers gone wrong in sweeps of 70: how many, how many of them were found, and wrong stripes."""

    sweeps: int
    injected: int
    found: int
    wrong_stripes: int


def faults(sweeps: int = FAULTY_SWEEPS, seed: int = 7) -> Faults:
    """Miss, double and delay triggers at random, in half of the sweeps with exposures counted.

    A fault is found when no stripe came from the frame that it spoilt: the stripe was taken again or is lost.
    A stripe is wrong when its frame was exposed with the mirror elsewhere than commanded.
    """
    rng = random.Random(seed)
    pattern = pattern_of(70)
    pitch = pattern[1][1] - pattern[0][1]
    injected = found = wrong = 0
    for number in range(sweeps):
        with emulated(EmulatorConfig()) as (board, driver):
            shutter = board.shutter
            shutter.wired = number % 2 == 0
            kinds = {place: rng.choice(("missed", "doubled", "late")) for place in range(160) if rng.random() < 0.05}
            shutter.missed = frozenset(place for place, kind in kinds.items() if kind == "missed")
            shutter.doubled = frozenset(place for place, kind in kinds.items() if kind == "doubled")
            shutter.late = {place: rng.uniform(0.0011, 0.02) for place, kind in kinds.items() if kind == "late"}
            camera = EmulatedTriggeredCamera(board, shutter, Picture(board))
            taken = take(driver, camera, pattern, AcquireOptions(sweep=SweepOptions(flash=FLASH)))
            openings, triggers = board.openings(), board.triggers()
            used = set()
            for stripe in taken:
                if stripe.on is None:
                    continue
                place = int(stripe.on[0, 0, 0]) * 256 + int(stripe.on[0, 1, 0])
                used.add(place)
                start, end = openings[place]
                # When the flash is over the mirror may turn on: the shutter is open, but nothing shines.
                lit_until = min(triggers, key=lambda trigger: abs(trigger - start)) + FLASH
                shown = board.exposure(start, min(end, lit_until))
                wrong += abs(shown.mirror_angle - stripe.mirror_angle) > 0.1 * pitch or shown.mirror_travel > 0
            struck = [place for place in kinds if place < len(triggers)]
            injected += len(struck)
            spoilt = _spoilt(openings, triggers, kinds, shutter.delay, shutter.wired)
            found += len(struck) - len({place for place, opening in spoilt if opening in used})
    return Faults(sweeps, injected, found, wrong)


def _spoilt(
    openings: tuple[tuple[float, float], ...],
    triggers: tuple[float, ...],
    kinds: dict[int, str],
    delay: float,
    counted: bool,
) -> list[tuple[int, int]]:
    """Pairs (trigger, opening) that must not be used: late ones, and the second of two; with counting, both of two.

    An opening that is on time for another trigger, which the camera was too busy to see, shows what that one was for,
    and is used for it.
    """
    spoilt = []
    for place, (start, _) in enumerate(openings):
        trigger = int(np.searchsorted(triggers, start, side="right")) - 1
        is_on_time = bool(np.min(np.abs(start - delay - np.array(triggers))) <= ON_TIME)
        if kinds.get(trigger) == "late" and not is_on_time:
            spoilt.append((trigger, place))
        if kinds.get(trigger) == "doubled" and (counted or not is_on_time):
            spoilt.append((trigger, place))
    return spoilt


@dataclass(frozen=True, slots=True)
class EndToEnd:
    """From the first trigger to the encoded grid, and the processor's part in it [s]."""

    seconds: float
    tail: float
    per_stripe: float
    after: float


def end_to_end(recording: scenes.Recording) -> EndToEnd:
    """Stripes arrive in emulated time; each is worked on, in turn, for as long as this machine's processor took."""
    from guara_perception.app.messages import terrain_to_message
    from guara_perception.app.node.live_scan import STRIPES_AFTER
    from transport.messages.terrain_codec import encode_terrain

    angles = {stripe.index: stripe.mirror_angle for stripe in recording.calibration.stripes}
    pattern = [(index, angles[index]) for index, _, _ in recording.frames]
    order = np.array([angle for _, angle in pattern])

    def render(view: ExposureView, settings: CameraSettings) -> Image:
        _, on, off = recording.frames[int(np.argmin(np.abs(order - view.mirror_angle)))]
        return on if view.laser_fraction > 0.5 else off

    with emulated() as (board, driver):
        board.shutter.wired = True
        camera = EmulatedTriggeredCamera(board, board.shutter, render)
        taken = take(driver, camera, pattern, AcquireOptions(sweep=SweepOptions(flash=FLASH)))
        begun = board.triggers()[0]
    best: EndToEnd | None = None
    for _ in range(3):
        processor = recording.processor()
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
        result = EndToEnd(free + after - begun, free + after - last, float(np.median(spent)), after)
        best = result if best is None or result.seconds < best.seconds else best
    assert best is not None
    return best


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
    rows = [triggered(stripes, flash) for stripes in STRIPES for flash in (0.002, FLASH)]
    for row in rows:
        say(_line("emulated board, 7 rad/s at once", row))
    for row in on_chip(say):
        say(_line("firmware on its chip, with its ramp", row))
    return rows


def measure(say: Callable[[str], object] = print, faulty_sweeps: int = FAULTY_SWEEPS) -> dict[str, object]:
    """Everything; returns what `--json` prints."""
    rows = by_light(say)
    free = by_rate(say)
    whole = end_to_end(scenes.simulated(SIZE, 70))
    say(
        f"first trigger to encoded grid {whole.seconds:.3f} s: {1e3 * whole.tail:.1f} ms after the last frame; "
        f"{1e3 * whole.per_stripe:.2f} ms of processor time a stripe, {1e3 * whole.after:.1f} ms for the grid"
    )
    slow = SLOWER * whole.per_stripe
    say(f"estimate, not measured: a board {SLOWER} times slower works on {1 / slow:.0f} stripes/s of this size")
    trouble = faults(faulty_sweeps)
    say(
        f"{trouble.sweeps} sweeps with triggers missed, doubled, late: {trouble.injected} injected, "
        f"{trouble.found} found, {trouble.wrong_stripes} wrong stripes"
    )
    standard = rows[-1]
    return {
        "triggered": {
            "stripes": standard.stripes,
            "flash_s": standard.flash,
            "seconds": round(standard.seconds, 4),
            "bound_s": round(standard.bound, 4),
            "proved": standard.proved,
            "end_to_end_s": round(whole.seconds, 4),
        },
        "free_running": free,
        "faults": {
            "sweeps": trouble.sweeps,
            "injected": trouble.injected,
            "found": trouble.found,
            "wrong_stripes": trouble.wrong_stripes,
        },
    }


def on_chip(say: Callable[[str], object]) -> list[Triggered]:
    """The rows with the firmware's ramp; none, and a word, where the emulated chip is not installed."""
    from drivers.emulator.chip import ChipMissing

    try:
        return [triggered_on_chip(stripes, flash) for stripes in STRIPES for flash in (0.002, FLASH)]
    except ChipMissing as missing:
        say(str(missing))
        return []


def _line(what: str, row: Triggered) -> str:
    share = row.seconds / row.bound
    return (
        f"{what}: {row.stripes} stripes at {1e3 * row.flash:g} ms of light in {row.seconds:.3f} s, "
        f"{share:.2f} of the bound {row.bound:.3f} s; {row.proved} of {row.stripes} proved"
    )


def section(faulty_sweeps: int) -> Section:
    """The table for the suite."""
    lines: list[str] = []
    figures = measure(lines.append, faulty_sweeps)
    return Section(
        name="sweeps",
        title="Sweeps",
        words="Emulated devices in emulated time; processor time for the work on pictures. The chip is emulated.",
        header=("what was found",),
        rows=[(line,) for line in lines],
        figures=figures,
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sweeps", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print all figures as one JSON object in the last line")
    arguments = parser.parse_args()
    figures = measure()
    if arguments.json:
        print(json.dumps(figures))


if __name__ == "__main__":
    main()
