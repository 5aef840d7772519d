"""Hardware at the pins of the emulated Pico: laser and photodiode, monostable, motor and home switch, camera."""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from drivers.emulator.light import Switching
from testbed.bench_board.shutter import Opening, Shutter

# Pins of the Pico, as in firmware/pins.h.
LASER, SUPPLY, HEARTBEAT, LIGHT, STEP, DIRECTION, HOME = 2, 3, 4, 5, 6, 7, 9
TRIGGER, EXPOSURE, EXPOSURE_WIRED = 10, 11, 12
# ADC input of the thermometer.
SENSOR = 4

# Delay from the laser to the comparator's output [ns].
LIGHT_DELAY = 0.1e6
# Distance from the home switch at power-up [steps].
START = 700


@dataclass(slots=True)
class Wiring:
    """Hardware connected to the chip, and its faults; may be changed at any time.

    Attributes:
        stuck_on: True = the laser's transistor always conducts.
        dead: True = the laser never emits light.
        blind: True = the photodiode never detects light.
        no_home: True = the home switch never closes.
        temperature: temperature of the chip [degrees Celsius].
        monostable: time without an edge of HEARTBEAT after which the laser loses its supply [s]; infinite = not fitted.
        shutter: shutter of the camera, opened by TRIGGER; if its EXPOSURE_ACTIVE is wired, the jumper is set too.
        transfer: time from the end of an exposure to the arrival of its image [s].
        on_picture: called at the arrival of an image with its shutter opening; the chip's time is stopped meanwhile.
    """

    stuck_on: bool = False
    dead: bool = False
    blind: bool = False
    no_home: bool = False
    temperature: float = 30.0
    monostable: float = 0.45
    shutter: Shutter = field(default_factory=Shutter)
    transfer: float = 0.0
    on_picture: Callable[[Opening], None] | None = None


class World:
    """State and history of the hardware, in emulated time since the first power-up [ns]."""

    def __init__(self, wiring: Wiring, now: Callable[[], float], noticed: Callable[[], None]) -> None:
        """Create the hardware; `connect` wires it to a chip.

        Args:
            wiring: connected hardware and its faults.
            now: returns the time [ns].
            noticed: called when the laser light has changed.
        """
        self.wiring = wiring
        self._now, self._noticed = now, noticed
        self.position = START
        self.powered = True
        self.lit = False
        self.switchings: list[tuple[float, bool]] = [(0.0, False)]
        self.steps: list[tuple[float, int]] = [(0.0, START)]
        self.triggers: list[float] = []
        self.openings: list[Opening] = []
        self._last_beat = -math.inf

    def connect(self, mcu: Any) -> None:
        """Wire a chip that has just been powered up or reset."""
        self._mcu = mcu
        clock = mcu.clock
        self._sense = clock.create_alarm(self._sensed)
        self._drop = clock.create_alarm(self.update)
        self._shutter = clock.create_alarm(self._toggle_shutter)
        self._arrival = clock.create_alarm(self._deliver)
        self._under_way: list[Opening] = []
        self._open = False
        self._to_come: list[Opening] = []
        gpio = mcu.gpio
        gpio[STEP].add_listener(self._on_step)
        gpio[LASER].add_listener(lambda now, before: self.update())
        gpio[SUPPLY].add_listener(lambda now, before: self.update())
        gpio[HEARTBEAT].add_listener(lambda now, before: self._on_beat())
        gpio[TRIGGER].add_listener(self._on_trigger)
        gpio[EXPOSURE].set_input_value(False)
        self.rewire()
        self.update()

    def rewire(self) -> None:
        """Set the input pins according to the wiring."""
        self._mcu.gpio[HOME].set_input_value(not self._home_closed())
        self._mcu.gpio[EXPOSURE_WIRED].set_input_value(not self.wiring.shutter.wired)
        volt = 0.706 - (self.wiring.temperature - 27) * 0.001721
        self._mcu.adc.channel_values[SENSOR] = round(volt / 3.3 * 4096)

    def update(self) -> None:
        """Switch the laser light on or off according to pins and faults."""
        now = self._now()
        held = now - self._last_beat < self.wiring.monostable * 1e9
        supply = self.powered and held and self._high(SUPPLY)
        lit = supply and not self.wiring.dead and (self._high(LASER) or self.wiring.stuck_on)
        if lit == self.lit:
            return
        self.lit = lit
        self.switchings.append((now, lit))
        self._sense.schedule(LIGHT_DELAY)
        self._noticed()

    def switched(self) -> tuple[Switching, ...]:
        """Return the changes of the laser light, with times in [s]."""
        return tuple(Switching(time / 1e9, on) for time, on in self.switchings)

    def lit_during(self, start: float, end: float) -> float:
        """Return the time during which the laser was lit between `start` and `end` [ns]."""
        total, until = 0.0, end
        for time, on in reversed(self.switchings):
            if time < until:
                since = max(time, start)
                total += (until - since) if on else 0.0
                until = since
            if time <= start:
                break
        return total

    def position_at(self, time: float) -> int:
        """Return the position of the mirror [steps from the home switch] at a time [ns]."""
        return self.steps[max(0, bisect.bisect_right(self.steps, (time, math.inf)) - 1)][1]

    def _high(self, pin: int) -> bool:
        return int(self._mcu.gpio[pin].value) == 1

    def _home_closed(self) -> bool:
        return self.position < 0 and not self.wiring.no_home

    def _on_step(self, now: Any, before: Any) -> None:
        if int(now) != 1 or int(before) != 0:
            return
        self.position += 1 if self._high(DIRECTION) else -1
        self.steps.append((self._now(), self.position))
        self._mcu.gpio[HOME].set_input_value(not self._home_closed())

    def _on_beat(self) -> None:
        self._last_beat = self._now()
        if math.isfinite(self.wiring.monostable):
            self._drop.schedule(self.wiring.monostable * 1e9)
        self.update()

    def _sensed(self) -> None:
        self._mcu.gpio[LIGHT].set_input_value(self.lit and not self.wiring.blind)

    def _on_trigger(self, now: Any, before: Any) -> None:
        if int(now) != 1 or int(before) == 1:
            return
        number, time = len(self.triggers), self._now() / 1e9
        self.triggers.append(self._now())
        closed_since = self.openings[-1][1] if self.openings else -math.inf
        found = self.wiring.shutter.openings(number, time, closed_since)
        self.openings.extend(found)
        self._to_come.extend(found)
        if found and not self._open:
            self._shutter.schedule(max(0.0, self._to_come[0][0] * 1e9 - self._now()))

    def _toggle_shutter(self) -> None:
        self._open = not self._open
        if self._open:
            self._shutter.schedule((self._to_come[0][1] - self._to_come[0][0]) * 1e9)
        else:
            self._under_way.append(self._to_come.pop(0))
            if len(self._under_way) == 1:
                self._arrival.schedule(self.wiring.transfer * 1e9)
            if self._to_come:
                self._shutter.schedule(max(0.0, self._to_come[0][0] * 1e9 - self._now()))
        if self.wiring.shutter.wired:
            self._mcu.gpio[EXPOSURE].set_input_value(self._open)

    def _deliver(self) -> None:
        opening = self._under_way.pop(0)
        if self._under_way:
            self._arrival.schedule(max(0.0, (self._under_way[0][1] + self.wiring.transfer) * 1e9 - self._now()))
        if self.wiring.on_picture is not None:
            self.wiring.on_picture(opening)
