"""Draws the circuit of `circuit.py` and lists the parts to buy.

`python wiring.py` writes docs/images/wiring.svg, docs/images/head.svg, docs/hardware/bom.csv and guara_board.kicad_sch.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

from circuit import ALIVE, CAMERA, HOME, LASER, MOTOR, PARTS, SENSOR, SUPPLY, Part, signals
from head import HEAD
from head import drawing as head_drawing

DOCS = Path(__file__).resolve().parents[1] / "docs"
COLUMNS = ((SUPPLY, HOME), (LASER,), (ALIVE, SENSOR), (MOTOR, CAMERA))
# In units of the grid: width of a column, of a box with few and with many pins, and of a pin.
COLUMN, SMALL, LARGE, PIN = 30, 8, 12, 2
UNIT_PX = 10


@dataclass(frozen=True, slots=True)
class Place:
    """Box of a part on the sheet, in units of the grid; y downwards."""

    part: Part
    x: int
    y: int
    width: int

    @property
    def rows(self) -> int:
        """Rows of pins."""
        return (len(self.part.pins) + 1) // 2

    def ends(self) -> Iterator[tuple[int, str, str | None, int, int, bool]]:
        """Number, name and net of each pin, the position of its end, and True on the left side."""
        count = len(self.part.pins)
        for number, (name, net) in enumerate(self.part.pins, 1):
            left = number <= self.rows
            # As on the part itself: down the left side, up the right one.
            row = number - 1 if left else count - number
            yield number, name, net, self.x - PIN if left else self.x + self.width + PIN, self.y + 1 + 2 * row, left


def sheet() -> tuple[list[tuple[str, int, int]], list[Place]]:
    """Return the headings (text, x, y) and the boxes of all parts."""
    headings, places = [], []
    for number, groups in enumerate(COLUMNS):
        y = 4
        for group in groups:
            headings.append((group, number * COLUMN + 1, y))
            y += 4
            for part in PARTS:
                if part.group == group:
                    width = LARGE if len(part.pins) > 4 else SMALL
                    place = Place(part, number * COLUMN + (COLUMN - width) // 2, y, width)
                    places.append(place)
                    y += 2 * place.rows + 3
            y += 2
    return headings, places


def _text(x: float, y: float, text: str, anchor: str = "start", size: int = 11, style: str = "") -> str:
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" font-size="{size}" {style}>{escape(text)}</text>'


def _wrapped(text: str, width: int) -> list[str]:
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) >= width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def drawing() -> str:
    """Return the circuit as SVG."""
    headings, places = sheet()
    width = len(COLUMNS) * COLUMN * UNIT_PX
    height = (max(place.y + 2 * place.rows for place in places) + 3) * UNIT_PX
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        _text(10, 22, "Laser board: pins with the same net name are joined. Red: the laser's current.", size=15),
    ]
    for group, x, y in headings:
        for line, text in enumerate(_wrapped(group, 44)):
            out.append(_text(x * UNIT_PX, y * UNIT_PX + 14 * line, text, size=12, style='font-weight="bold"'))
    path = {"VBUS", "5V", "HAND", "CHAIN", "LASER_PLUS"}
    wired = signals()
    for place in places:
        part = place.part
        x, y, box_width = place.x * UNIT_PX, place.y * UNIT_PX, place.width * UNIT_PX
        fill = "#e8f1e4" if part.ref == "U1" else "#f4efe2"
        out.append(
            f'<rect x="{x}" y="{y}" width="{box_width}" height="{20 * place.rows}" rx="3" fill="{fill}" stroke="#333"/>'
        )
        out.append(_text(x + box_width / 2, y - 3, f"{part.ref}  {part.value}", "middle", style='font-weight="bold"'))
        for number, name, net, at_x, at_y, left in place.ends():
            edge = x if left else x + box_width
            end, line_y = at_x * UNIT_PX, at_y * UNIT_PX
            colour = "#b00020" if net in path else "#333" if net else "#bbb"
            out.append(f'<path d="M{edge},{line_y}H{end}" stroke="{colour}" stroke-width="1.5"/>')
            out.append(_text((edge + end) / 2, line_y - 2, str(number), "middle", 8))
            anchor, outer = ("start", "end") if left else ("end", "start")
            out.append(_text(edge + (3 if left else -3), line_y + 4, name, anchor, 10))
            if net:
                bold = 'font-weight="bold"' if part.ref == "U1" and number in wired else ""
                out.append(_text(end + (-3 if left else 3), line_y + 4, net, outer, 10, f'fill="{colour}" {bold}'))
    out.append("</svg>")
    return "\n".join(out) + "\n"


def shopping() -> str:
    """Return the list of parts as CSV, equal ones in one line."""
    lines: dict[tuple[str, ...], list[str]] = {}
    for part in (*HEAD, *PARTS):
        lines.setdefault((part.value, part.package, part.look_for, *part.makers), []).append(part.ref)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["reference", "value", "package", "quantity", "look for", "class 1", "class 2", "class 3"])
    for (value, package, *rest), refs in lines.items():
        writer.writerow([" ".join(refs), value, package, len(refs), *rest])
    return out.getvalue()


def files() -> dict[Path, str]:
    """Return the text of every file that is made from the tables."""
    from kicad import schematic

    return {
        DOCS / "images" / "wiring.svg": drawing(),
        DOCS / "images" / "head.svg": head_drawing(),
        DOCS / "hardware" / "bom.csv": shopping(),
        DOCS / "hardware" / "guara_board.kicad_sch": schematic(*sheet()),
    }


if __name__ == "__main__":
    for path, text in files().items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
