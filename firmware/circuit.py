"""The circuit of the rangefinder: every part, every pin and its net, in one table.

`wiring.py` draws it and lists what to buy, `kicad.py` writes it for KiCad; `head.py` has the unwired parts.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

PINS = Path(__file__).resolve().parent / "pins.h"
# GPIO to pin of the Pico's board.
BOARD_PIN = {2: 4, 3: 5, 4: 6, 5: 7, 6: 9, 7: 10, 8: 11, 9: 12, 10: 14, 11: 15, 12: 16}
SUPPLIES = ("VBUS", "5V", "3V3", "VM")
Nets = dict[str, list[tuple[str, int]]]


@dataclass(frozen=True, slots=True)
class Part:
    """One part.

    Attributes:
        ref: its reference; the letters say the kind.
        value: value or type.
        package: package or form.
        look_for: property by which it is chosen.
        makers: part classes of three makers that have it.
        pins: (name, net) of pins 1, 2, ...; the net is None for an open pin.
        group: heading under which it is drawn.
    """

    ref: str
    value: str
    package: str
    look_for: str
    makers: tuple[str, str, str]
    pins: tuple[tuple[str, str | None], ...]
    group: str

    @property
    def kind(self) -> str:
        """The letters of the reference."""
        return self.ref.rstrip("0123456789")


def signals() -> dict[int, str]:
    """Return the signal at each pin of the Pico's board, as pins.h names it."""
    found = re.findall(r"PIN_(\w+) = (\d+)", PINS.read_text())
    return {BOARD_PIN[int(number)]: name for name, number in found if int(number) in BOARD_PIN}


def _pico() -> tuple[tuple[str, str | None], ...]:
    other = {40: ("VBUS", "VBUS"), 39: ("VSYS", None), 37: ("3V3_EN", None), 36: ("3V3", "3V3"), 35: ("ADC_VREF", None)}
    other |= {30: ("RUN", "RUN"), 33: ("AGND", "GND")} | dict.fromkeys((3, 8, 13, 18, 23, 28, 38), ("GND", "GND"))
    gpio = [pin for pin in range(1, 35) if pin not in other]
    numbers = dict(zip(gpio, [*range(23), 26, 27, 28], strict=True))
    named = signals()
    return tuple(other.get(pin) or (f"GP{numbers[pin]}", named.get(pin)) for pin in range(1, 41))


RESISTOR = ("Vishay MRS25", "Yageo MFR-25", "TE LR1F")
CERAMIC = ("Murata RDER", "TDK FG", "Kemet C320")
SIGNAL_NMOS = ("onsemi 2N7002", "Nexperia 2N7002", "Diodes 2N7002")
POWER_PMOS = ("AOS AO3401A", "Vishay Si2301", "Diodes DMP2035U")
TERMINAL = ("Phoenix MKDS", "Wurth 691", "TE 282836")
TRIMMER = ("Bourns 3296W", "Vishay T93", "Suntan TSR-3296")


def _two(kind: str, value: str, first: str, second: str, group: str) -> Part:
    if kind.startswith("R"):
        return Part(kind, value, "axial 0207", "1 %, 0.25 W metal film", RESISTOR, (("1", first), ("2", second)), group)
    return Part(kind, value, "radial 5 mm", "X7R ceramic, 16 V or more", CERAMIC, (("1", first), ("2", second)), group)


def _terminal(ref: str, value: str, look_for: str, pins: tuple[tuple[str, str | None], ...], group: str) -> Part:
    return Part(ref, value, f"screw terminal, {len(pins)} poles", look_for, TERMINAL, pins, group)


def _mosfet(ref: str, value: str, gate: str, source: str, drain: str) -> Part:
    p_channel = value == "AO3401A"
    look_for = "P-channel, on at 2.5 V, 20 V or more" if p_channel else "N-channel, threshold below 2.5 V"
    pins = (("G", gate), ("S", source), ("D", drain))
    return Part(ref, value, "SOT-23", look_for, POWER_PMOS if p_channel else SIGNAL_NMOS, pins, LASER)


SUPPLY, LASER, ALIVE, SENSOR, MOTOR, HOME, CAMERA = (
    "Pico and its supply",
    "The laser's current: VBUS, fuse F1, switch SW1, Q1 (A), Q4 (B), J1",
    "Monostable: 0.45 s after the last heartbeat SUPPLY no longer counts",
    "Photodiode: LIGHT is high while the laser shines",
    "Motor",
    "Home switch: HOME is low below step 0",
    "Camera",
)
PARTS = (
    Part(
        "U1", "Raspberry Pi Pico", "40 pins", "RP2040 B2", ("Pico", "Pico H", "no clone"), _pico(), SUPPLY
    ),
    Part(
        "F1",
        "200 mA",
        "radial",
        "resettable fuse, 200 mA hold, 6 V or more",
        ("Littelfuse RXEF020", "Bourns MF-R020", "Bel 0ZRC0020"),
        (("1", "VBUS"), ("2", "5V")),
        SUPPLY,
    ),
    Part(
        "D1",
        "P6KE6.8A",
        "DO-15",
        "suppressor, 5.8 V stand-off; band to 5V",
        ("Littelfuse P6KE", "Vishay P6KE", "STMicroelectronics P6KE"),
        (("K", "5V"), ("A", "GND")),
        SUPPLY,
    ),
    _two("C1", "10 uF", "5V", "GND", SUPPLY),
    _two("C2", "10 uF", "3V3", "GND", SUPPLY),
    _two("C9", "10 uF", "VBUS", "GND", SUPPLY),
    Part(
        "SW2",
        "RUN",
        "6 x 6 mm",
        "push button: holds the Pico in reset (first power-up)",
        ("Omron B3F", "TE FSM", "Wurth 430"),
        (("1", "RUN"), ("2", "GND")),
        SUPPLY,
    ),
    Part(
        "SW1",
        "laser, by hand",
        "panel, latching",
        "toggle or emergency stop, 1 A, within reach",
        ("C&K 7101", "NKK M2012", "APEM 5636"),
        (("1", "5V"), ("2", "HAND")),
        LASER,
    ),
    _mosfet("Q1", "AO3401A", "GATE_A", "HAND", "CHAIN"),
    _two("R1", "10 kOhm", "HAND", "GATE_A", LASER),
    _mosfet("Q2", "2N7002", "SUPPLY", "BETWEEN", "GATE_A"),
    _mosfet("Q3", "2N7002", "ALIVE", "GND", "BETWEEN"),
    _two("R2", "100 kOhm", "SUPPLY", "GND", LASER),
    _two("R3", "100 kOhm", "ALIVE", "GND", LASER),
    _mosfet("Q4", "AO3401A", "GATE_B", "CHAIN", "LASER_PLUS"),
    _two("R4", "10 kOhm", "CHAIN", "GATE_B", LASER),
    _mosfet("Q5", "2N7002", "LASER", "GND", "GATE_B"),
    _two("R5", "100 kOhm", "LASER", "GND", LASER),
    _two("R6", "1 kOhm", "LASER_PLUS", "GND", LASER),
    _terminal("J1", "laser module", "module of class 2, 5 V", (("plus", "LASER_PLUS"), ("minus", "GND")), LASER),
    Part(
        "U2",
        "74HC123",
        "DIP-16",
        "supplied from 3.3 V; its pulse is 0.45 R C (of 1.0 R C: C4 470 nF)",
        ("TI CD74HC123", "Nexperia 74HC123", "Toshiba TC74HC123A (1.0 R C)"),
        (
            ("/A1", "GND"), ("B1", "HEARTBEAT"), ("/R1", "POWER_UP"), ("/Q1", None), ("Q2", None), ("C2", None),
            ("RC2", None), ("GND", "GND"), ("/A2", "GND"), ("B2", "GND"), ("/R2", "GND"), ("/Q2", None),
            ("Q1", "ALIVE"), ("C1", "TIME_C"), ("RC1", "TIME_RC"), ("VCC", "3V3"),
        ),
        ALIVE,
    ),
    _two("C3", "100 nF", "3V3", "GND", ALIVE),
    Part(
        "C4",
        "1 uF",
        "film, 5 mm",
        "polyester film, 5 %: an electrolytic leaks",
        ("Wima MKS2", "Kemet R82", "TDK B32529"),
        (("1", "TIME_C"), ("2", "TIME_RC")),
        ALIVE,
    ),
    _two("R7", "680 kOhm", "TIME_RC", "TIME_TRIM", ALIVE),
    Part(
        "RV1",
        "500 kOhm",
        "3296W",
        "trimmer of 25 turns: set 0.45 s",
        TRIMMER,
        (("1", "TIME_TRIM"), ("wiper", "3V3"), ("3", "3V3")),
        ALIVE,
    ),
    Part(
        "D2",
        "1N4148",
        "DO-35",
        "empties C4 when the supply goes; band to 3V3",
        ("Vishay 1N4148", "onsemi 1N4148", "Diodes 1N4148"),
        (("K", "3V3"), ("A", "TIME_RC")),
        ALIVE,
    ),
    _two("R8", "100 kOhm", "HEARTBEAT", "GND", ALIVE),
    _two("R9", "100 kOhm", "3V3", "POWER_UP", ALIVE),
    _two("C5", "100 nF", "POWER_UP", "GND", ALIVE),
    Part(
        "D3",
        "BPW34",
        "DIL, clear",
        "photodiode of 7.5 mm2; behind a piece of the band-pass film",
        ("Vishay BPW34", "ams-Osram BPW34", "Vishay VBPW34S"),
        (("K", "3V3"), ("A", "SEEN")),
        SENSOR,
    ),
    _two("R10", "22 kOhm", "SEEN", "GND", SENSOR),
    _two("C6", "1 nF", "SEEN", "GND", SENSOR),
    Part(
        "U3",
        "LM393",
        "DIP-8",
        "comparator, open collector",
        ("TI LM393", "onsemi LM393", "STMicroelectronics LM393"),
        (
            ("OUT1", "LIGHT"), ("IN1-", "THRESHOLD"), ("IN1+", "SEEN"), ("GND", "GND"),
            ("IN2+", "GND"), ("IN2-", "THRESHOLD"), ("OUT2", None), ("VCC", "5V"),
        ),
        SENSOR,
    ),
    _two("C7", "100 nF", "5V", "GND", SENSOR),
    _two("R11", "10 kOhm", "3V3", "LIGHT", SENSOR),
    _two("R12", "2.2 MOhm", "LIGHT", "SEEN", SENSOR),
    _two("R13", "10 kOhm", "3V3", "TRIM_TOP", SENSOR),
    Part(
        "RV2",
        "10 kOhm",
        "3296W",
        "trimmer of 25 turns: half of what SEEN is in the light",
        TRIMMER,
        (("1", "TRIM_TOP"), ("wiper", "THRESHOLD"), ("3", "GND")),
        SENSOR,
    ),
    Part(
        "U4",
        "TMC2209",
        "module, 16 pins",
        "named as printed on the module; makers order them differently",
        ("Trinamic SilentStepStick", "BigTreeTech TMC2209", "FYSETC TMC2209"),
        (
            ("EN", "MOTOR_OFF"), ("MS1", "GND"), ("MS2", "3V3"), ("PDN", "HOLD"), ("UART", None), ("CLK", "GND"),
            ("STEP", "STEP"), ("DIR", "DIRECTION"), ("VM", "VM"), ("GND", "GND"), ("A2", "COIL_A2"), ("A1", "COIL_A1"),
            ("B1", "COIL_B1"), ("B2", "COIL_B2"), ("VIO", "3V3"), ("GND2", "GND"),
        ),
        MOTOR,
    ),
    _two("C8", "100 nF", "3V3", "GND", MOTOR),
    _two("C10", "100 nF", "VM", "GND", MOTOR),
    Part(
        "C11",
        "100 uF",
        "radial",
        "electrolytic, 35 V, low ESR, beside VM",
        ("Panasonic FR", "Nichicon UHE", "Rubycon ZLH"),
        (("1", "VM"), ("2", "GND")),
        MOTOR,
    ),
    _two("R14", "10 kOhm", "3V3", "MOTOR_OFF", MOTOR),
    _two("R15", "10 kOhm", "3V3", "HOLD", MOTOR),
    _two("R16", "100 kOhm", "STEP", "GND", MOTOR),
    _two("R17", "100 kOhm", "DIRECTION", "GND", MOTOR),
    _terminal("J2", "motor supply", "5 to 12 V, 1 A", (("plus", "MOTOR_IN"), ("minus", "GND")), MOTOR),
    Part(
        "F2",
        "1 A",
        "5 x 20 mm",
        "slow fuse with holder",
        ("Littelfuse 218", "Schurter SPT", "Bel 5ST"),
        (("1", "MOTOR_IN"), ("2", "VM")),
        MOTOR,
    ),
    _terminal(
        "J3",
        "motor",
        "NEMA 8, bipolar",
        (("A1", "COIL_A1"), ("A2", "COIL_A2"), ("B1", "COIL_B1"), ("B2", "COIL_B2")),
        MOTOR,
    ),
    _terminal(
        "J4",
        "home switch",
        "slotted, phototransistor or open collector, slit 0.5 mm, repeats to 10 um",
        (("LED", "HOME_LED"), ("GND", "GND"), ("OUT", "HOME")),
        HOME,
    ),
    _two("R18", "220 Ohm", "3V3", "HOME_LED", HOME),
    _two("R19", "10 kOhm", "3V3", "HOME", HOME),
    _terminal(
        "J5",
        "camera",
        "3.3 V; an industrial camera by an optocoupler",
        (("TRIGGER", "TRIGGER_OUT"), ("EXPOSURE", "EXPOSURE_IN"), ("GND", "GND")),
        CAMERA,
    ),
    _two("R20", "1 kOhm", "TRIGGER", "TRIGGER_OUT", CAMERA),
    _two("R21", "1 kOhm", "EXPOSURE_IN", "EXPOSURE", CAMERA),
    _two("R22", "100 kOhm", "EXPOSURE", "GND", CAMERA),
    _two("R23", "10 kOhm", "3V3", "EXPOSURE_WIRED", CAMERA),
    Part(
        "JP1",
        "EXPOSURE wired",
        "2 pins, 2.54 mm",
        "set when EXPOSURE is wired",
        ("Harwin M7566", "Wurth 609", "Samtec SNT"),
        (("1", "EXPOSURE_WIRED"), ("2", "GND")),
        CAMERA,
    ),
)  # fmt: skip


def nets() -> Nets:
    """Return the (reference, pin) pairs of each net."""
    found: Nets = defaultdict(list)
    for part in PARTS:
        for number, (_, net) in enumerate(part.pins, 1):
            if net is not None:
                found[net].append((part.ref, number))
    return dict(found)
