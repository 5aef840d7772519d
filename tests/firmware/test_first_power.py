"""`guara doctor --bring-up` with the whole firmware on its emulated chip: LED first, then a laser."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from drivers import BoardConfig, LaserBoard
from drivers.emulator.backend import EmulatedBackend
from guara_perception.app.bring_up import bring_up
from testbed.chip import Chip, ChipBus, ChipClock

pytestmark = pytest.mark.chip


def test_the_firmware_passes_the_first_power(new_chip: Callable[[], Chip], tmp_path: Path) -> None:
    """A person who does as asked; wires go while the light shines, counted by the program's own waits."""
    chip = new_chip()
    bus, said = ChipBus(chip), list[str]()
    clock = ChipClock(bus)
    pending: list[Callable[[], object]] = []
    sleep = clock.sleep

    def slept(seconds: float) -> None:
        sleep(seconds)
        if pending and chip.world.lit:
            pending.pop()()

    clock.sleep = slept  # type: ignore[method-assign]

    def wire(name: str, value: bool | float) -> Callable[[], object]:
        def change() -> None:
            setattr(chip.wiring, name, value)
            chip.rewire()

        return change

    deeds: dict[str, Callable[[], object]] = {
        "Leave D3": wire("blind", True),
        "Connect D3": wire("blind", False),
        "Bridge Q4": wire("stuck_on", True),
        "Remove the bridge": wire("stuck_on", False),
        "Get ready to hold RUN": lambda: pending.append(chip.unplug),
        "Release RUN": lambda: (chip.replug(), bus.await_device()),
        "Get ready to pull": lambda: pending.append(wire("dead", True)),
        "Put the wire": wire("dead", False),
        "Get ready to open": lambda: pending.append(wire("dead", True)),
        "Close SW1": wire("dead", False),
    }

    def run(light: str) -> bool:
        def ask(question: str) -> str:
            for beginning, deed in deeds.items():
                if question.startswith(beginning):
                    deed()
            return light if question.startswith("What") else "done" if question.endswith("[done]") else "yes"

        device = LaserBoard(BoardConfig(handle_signals=False), backend=EmulatedBackend(bus))
        return bring_up(device, tmp_path, ask, said.append)

    with clock:
        assert run("led"), said
        assert run("laser"), said
    assert not chip.world.lit
