"""Emulated sweeps with missed, doubled and late triggers: how many are detected, and how many stripes are wrong."""

from __future__ import annotations

import random

import numpy as np

from drivers import AcquireOptions, SweepOptions
from drivers.emulator import EmulatorConfig
from testbed.emulated_sweeps import FLASH, Picture, emulated, firing_order_of, take
from testbed.triggered_camera import EmulatedTriggeredCamera

# How far from its trigger an opening may lie and be on time [s]: half of the tolerance of `SweepOptions`, and drift of
# the clocks.
ON_TIME = 0.0005 + 0.0001


def faults(sweeps: int, seed: int = 7) -> dict[str, int]:
    """Miss, double and delay triggers at random, in sweeps of 70 stripes; in half of them the board counts exposures.

    A fault is found when no stripe came from the frame that it spoilt: the stripe was taken again or is lost.
    A stripe is wrong when its frame was exposed with the mirror elsewhere than commanded.

    Returns:
        Numbers of sweeps, of faulty triggers, of those that were found, and of wrong stripes.
    """
    rng = random.Random(seed)
    firing_order = firing_order_of(70)
    pitch = firing_order[1][1] - firing_order[0][1]
    injected = found = wrong = 0
    for sweep in range(sweeps):
        with emulated(EmulatorConfig()) as (board, driver):
            shutter = board.shutter
            shutter.wired = sweep % 2 == 0
            kinds = {number: rng.choice(("missed", "doubled", "late")) for number in range(160) if rng.random() < 0.05}
            shutter.missed, shutter.doubled = (
                frozenset(number for number, kind in kinds.items() if kind == each) for each in ("missed", "doubled")
            )
            shutter.late = {number: rng.uniform(0.0011, 0.02) for number, kind in kinds.items() if kind == "late"}
            camera = EmulatedTriggeredCamera(board, shutter, Picture(board))
            taken = take(driver, camera, firing_order, AcquireOptions(sweep=SweepOptions(flash=FLASH)))
            openings, triggers = board.openings(), board.triggers()
            used = set()
            for stripe in taken:
                if stripe.on is None:
                    continue
                number = int(stripe.on[0, 0, 0]) * 256 + int(stripe.on[0, 1, 0])
                used.add(number)
                start, end = openings[number]
                # After the flash the mirror may turn: the shutter is still open, but the laser is off.
                lit_until = min(triggers, key=lambda trigger: abs(trigger - start)) + FLASH
                shown = board.exposure(start, min(end, lit_until))
                wrong += abs(shown.mirror_angle - stripe.mirror_angle) > 0.1 * pitch or shown.mirror_travel > 0
            struck = [number for number in kinds if number < len(triggers)]
            injected += len(struck)
            spoilt = _spoilt(openings, triggers, kinds, shutter.delay, shutter.wired)
            found += len(struck) - len({number for number, opening in spoilt if opening in used})
    return {"sweeps": sweeps, "injected": injected, "found": found, "wrong_stripes": wrong}


def _spoilt(
    openings: tuple[tuple[float, float], ...],
    triggers: tuple[float, ...],
    kinds: dict[int, str],
    delay: float,
    counted: bool,
) -> list[tuple[int, int]]:
    """Pairs (trigger, opening) that must not be used: late, or the second of a double; if counted, both of a double.

    A late opening may be on time for another trigger, one that came while the camera was busy: it shows the stripe of
    that trigger and may be used for it.
    """
    spoilt = []
    for number, (start, _) in enumerate(openings):
        trigger = int(np.searchsorted(triggers, start, side="right")) - 1
        is_on_time = bool(np.min(np.abs(start - delay - np.array(triggers))) <= ON_TIME)
        kind = kinds.get(trigger)
        if kind in ("late", "doubled") and (not is_on_time or (kind == "doubled" and counted)):
            spoilt.append((trigger, number))
    return spoilt
