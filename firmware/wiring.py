"""Draws docs/images/wiring.svg: what is wired to which pin of the Pico. Pin numbers come from pins.h.

`python wiring.py > ../docs/images/wiring.svg`
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from xml.sax.saxutils import escape

PINS = Path(__file__).resolve().parent / "pins.h"
# GPIO to pin of the Pico's board.
BOARD_PIN = {2: 4, 3: 5, 4: 6, 5: 7, 6: 9, 7: 10, 8: 11, 9: 12, 10: 14, 11: 15, 12: 16}

WIDTH, HEIGHT = 1000, 600
PICO = (370, 70, 260, 400)
ROW, FIRST_ROW = 46, 110
# Side of the Pico, signals that the part is wired to, and its lines of text.
PARTS = (
    ("left", ("LASER",), ("P-MOSFET B, laser", "N-MOSFET 2N7002 at its gate")),
    ("left", ("SUPPLY",), ("P-MOSFET A, supply", "two 2N7002 in series at its gate")),
    ("left", ("HEARTBEAT",), ("monostable 74HC123, 0.45 s", "output to the second 2N7002 of A")),
    ("left", ("LIGHT",), ("comparator LM393 with BPW34", "high while the laser shines")),
    ("right", ("STEP", "DIRECTION", "MOTOR_OFF"), ("stepper driver TMC2209", "STEP, DIR, EN; 64 microsteps")),
    ("right", ("HOME",), ("home switch to ground", "closed below step 0")),
    ("right", ("TRIGGER",), ("camera, trigger input", "3.3 V, or by an optocoupler")),
    ("right", ("EXPOSURE",), ("camera, EXPOSURE_ACTIVE", "3.3 V, high while it exposes")),
    ("right", ("EXPOSURE_WIRED",), ("jumper to ground", "set when the line above is wired")),
)


def pins() -> dict[str, int]:
    """Return the GPIO of each signal, as pins.h has it."""
    return {name: int(number) for name, number in re.findall(r"PIN_(\w+) = (\d+)", PINS.read_text())}


def _text(x: float, y: float, text: str, anchor: str = "start", size: int = 13, weight: str = "normal") -> str:
    return (
        f'<text x="{x}" y="{y}" text-anchor="{anchor}" font-size="{size}" font-weight="{weight}">{escape(text)}</text>'
    )


def _box(x: float, y: float, width: float, height: float, fill: str) -> str:
    return f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="4" fill="{fill}" stroke="#333"/>'


def _wire(points: list[tuple[float, float]], colour: str = "#333") -> str:
    path = " ".join(f"{x},{y}" for x, y in points)
    return f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>'


def drawing() -> str:
    """Return the diagram as SVG."""
    gpio = pins()
    left, top, width, height = PICO
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
        _box(left, top, width, height, "#e8f1e4"),
        _text(left + width / 2, top - 14, "Raspberry Pi Pico (RP2040)", "middle", 15, "bold"),
    ]
    rows = {"left": FIRST_ROW, "right": FIRST_ROW}
    for side, signals, lines in PARTS:
        first = rows[side]
        gap = ROW if len(signals) == 1 else 30
        ys = [first + gap * number for number in range(len(signals))]
        rows[side] = ys[-1] + (62 if side == "right" else 92)
        edge, inner, outer, anchor = (
            (left, left + 8, 300, "start") if side == "left" else (left + width, left + width - 8, 700, "end")
        )
        box_x = 60 if side == "left" else 700
        out.append(_box(box_x, ys[0] - 24, 240, ys[-1] - ys[0] + 48, "#f4efe2"))
        centre = (ys[0] + ys[-1]) / 2
        out += [_text(box_x + 120, centre - 3 + 16 * line, text, "middle", 12) for line, text in enumerate(lines)]
        for signal, y in zip(signals, ys, strict=True):
            out.append(_wire([(edge, y), (outer, y)]))
            out.append(_text(inner, y + 4, f"GP{gpio[signal]} {signal}", "start" if anchor == "start" else "end", 12))
            x = edge - 6 if side == "left" else edge + 6
            out.append(_text(x, y - 5, str(BOARD_PIN[gpio[signal]]), "end" if side == "left" else "start", 11))
    # The chain of the laser's current, from the supply to the diode.
    red = "#b00020"
    chain = ["USB 5 V (pin 40, VBUS)", "A: SUPPLY and monostable", "B: LASER", "module of class 2", "ground"]
    y, x = 545, 30
    out.append(_text(30, 515, "the laser's current passes:", size=12, weight="bold"))
    for number, name in enumerate(chain):
        box_width = 8 + 7.2 * len(name)
        if number:
            out.append(_wire([(x - 14, y), (x, y)], red))
        out.append(_box(x, y - 14, box_width, 28, "#fbe9eb"))
        out.append(_text(x + box_width / 2, y + 4, name, "middle", 12))
        x += box_width + 14
    out.append(_text(30, 588, "All grounds are joined. Every 2N7002 has 100 kOhm from gate to ground.", "start", 11))
    out.append("</svg>")
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    sys.stdout.write(drawing())
