"""The circuit as a KiCad schematic (format of KiCad 7; later ones open it), which includes its own symbols."""

from __future__ import annotations

import json
import uuid
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wiring import Place

MM = 2.54
FONT = "(effects (font (size 1 1)){})"


def _id(*of: object) -> str:
    return str(uuid.uuid5(uuid.NAMESPACE_URL, "guara-board/" + "/".join(map(str, of))))


def _at(x: int, y: int, angle: int = 0) -> str:
    return f"(at {x * MM:.2f} {y * MM:.2f} {angle})"


def _property(name: str, value: str, at: str, hidden: bool = False) -> str:
    hide = " hide" if hidden else ""
    return f"    (property {json.dumps(name)} {json.dumps(value)} {at} {FONT.format(hide)})"


def _symbol(place: Place) -> list[str]:
    part, bottom = place.part, -2 * place.rows
    out = [
        f'  (symbol "guara:{part.ref}" (in_bom yes) (on_board yes)',
        _property("Reference", part.kind, _at(0, 1)),
        _property("Value", part.value, _at(0, bottom - 1)),
        f'    (symbol "{part.ref}_0_1" (rectangle (start 0 0) (end {place.width * MM:.2f} {bottom * MM:.2f})'
        " (stroke (width 0.2) (type default)) (fill (type background))))",
        f'    (symbol "{part.ref}_1_1"',
    ]
    for number, name, net, x, y, left in place.ends():
        # Symbols have y upwards; a pin's place is its outer end, its angle the way inwards.
        at = _at(x - place.x, place.y - y, 0 if left else 180)
        kind = "no_connect" if net is None else "passive"
        out.append(
            f"      (pin {kind} line {at} (length {2 * MM:.2f}) (name {json.dumps(name)} {FONT.format('')})"
            f' (number "{number}" {FONT.format("")}))'
        )
    return [*out, "    )", "  )"]


def schematic(headings: list[tuple[str, int, int]], places: list[Place]) -> str:
    """Return the text of the file.

    Args:
        headings: text and place of each heading, in units of the grid.
        places: where each part stands.
    """
    root = _id()
    out = [
        f'(kicad_sch (version 20230121) (generator guara) (uuid {root}) (paper "A3")',
        '(title_block (title "Guara laser board") (comment 1 "made by firmware/wiring.py of firmware/circuit.py"))',
        "(lib_symbols",
        *(line for place in places for line in _symbol(place)),
        ")",
    ]
    for text, x, y in headings:
        size = "(effects (font (size 1.2 1.2) bold) (justify left))"
        out.append(f"(text {json.dumps(text)} {_at(x, y - 1)} {size} (uuid {_id('text', text)}))")
    for place in places:
        part = place.part
        out += [
            f'(symbol (lib_id "guara:{part.ref}") {_at(place.x, place.y)} (unit 1) (in_bom yes) (on_board yes) (dnp no)'
            f" (uuid {_id(part.ref)})",
            _property("Reference", part.ref, _at(place.x + 1, place.y - 1)),
            _property("Value", part.value, _at(place.x + 4, place.y - 1)),
            _property("Footprint", "", _at(place.x, place.y), True),
        ]
        out += [f'    (pin "{number}" (uuid {_id(part.ref, number)}))' for number, *_ in place.ends()]
        out.append(
            f'    (instances (project "guara_board" (path "/{root}" (reference "{part.ref}") (unit 1))))\n)',
        )
        for number, _, net, x, y, left in place.ends():
            if net is None:
                out.append(f"(no_connect (at {x * MM:.2f} {y * MM:.2f}) (uuid {_id(part.ref, number, 'open')}))")
                continue
            side = "right" if left else "left"
            out.append(
                f"(global_label {json.dumps(net)} (shape passive) {_at(x, y, 180 if left else 0)}"
                f" (effects (font (size 1 1)) (justify {side})) (uuid {_id(part.ref, number, net)}))"
            )
    out.append('(sheet_instances (path "/" (page "1")))\n)')
    return "\n".join(out) + "\n"
