"""Triggers missed, doubled and late in emulated sweeps: how many are found, and whether one leads to a wrong stripe."""

from __future__ import annotations

import random
from dataclasses import dataclass

import numpy as np

from benchmarks.emulated_sweeps import FLASH, Picture, emulated, pattern_of, take
from drivers import AcquireOptions, SweepOptions
from drivers.emulator import EmulatedTriggeredCamera, EmulatorConfig

FAULTY_SWEEPS = 200
# Seconds within which an opening is on time for a trigger: half of the tolerance of `SweepOptions`, and clocks' drift.
ON_TIME = 0.0005 + 0.0001


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
