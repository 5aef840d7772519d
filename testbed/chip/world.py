"""What is wired to the pins of the emulated Pico: laser and photodiode, monostable, motor and home switch, camera."""

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
SENSOR = 4  # input of the ADC: the thermometer

LIGHT_DELAY = 0.1e6  # ns from the laser to the comparator's output
START = 700  # steps from the home switch at power-up


@dataclass(slots=True)
class Wiring:
    """What is connected to the chip, and its faults; may be changed at any time.

    Attributes:
        stuck_on: the laser's transistor conducts whatever its pin says.
        dead: the laser never shines.
        blind: the photodiode sees nothing.
        no_home: the home switch never closes.
        temperature: temperature of the chip [degrees Celsius].
        monostable: time without an edge of HEARTBEAT after which the supply opens [s]; infinite: not fitted.
        shutter: the camera's shutter, opened by TRIGGER; where its EXPOSURE_ACTIVE is wired, the jumper is set too.
        transfer: time from the end of an exposure until its picture has arrived [s].
        on_picture: called at that time, with the opening; the chip's time stands still meanwhile.
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
    """The state of the wiring and its past. Its times are emulated nanoseconds since the first power-up."""

    def __init__(self, wiring: Wiring, now: Callable[[], float], noticed: Callable[[], None]) -> None:
        """Prepare.

        Args:
            wiring: what is connected, and its faults.
            now: the time [ns].
            noticed: called when the light has changed.
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
        """Let what was changed in the wiring take effect at the pins."""
        self._mcu.gpio[HOME].set_input_value(not self._home_closed())
        self._mcu.gpio[EXPOSURE_WIRED].set_input_value(not self.wiring.shutter.wired)
        volt = 0.706 - (self.wiring.temperature - 27) * 0.001721
        self._mcu.adc.channel_values[SENSOR] = round(volt / 3.3 * 4096)

    def update(self) -> None:
        """Switch the light on or off, as pins and faults now require."""
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
        """Return when the laser really went on and off [s]."""
        return tuple(Switching(time / 1e9, on) for time, on in self.switchings)

    def lit_during(self, start: float, end: float) -> float:
        """Return for how many of the nanoseconds from `start` to `end` the laser shone."""
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
        """Return where the mirror was [steps from the home switch] at a time [ns]."""
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
