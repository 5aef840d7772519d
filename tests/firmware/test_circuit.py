"""The circuit of the table: its nets, its darkness when a pin floats, and the files that are made of it."""

from __future__ import annotations

import csv
import itertools
import re
import sys
from typing import Any

import pytest

from tests.firmware.conftest import FIRMWARE

sys.path.insert(0, str(FIRMWARE))
import circuit
import head
import wiring

PARTS = {part.ref: part for part in circuit.PARTS}
NETS = circuit.nets()
BUILD = FIRMWARE.parent / "docs" / "build.md"


def ends(ref: str) -> set[str | None]:
    return {net for _, net in PARTS[ref].pins}


def bridges(kind: str, first: str, second: str) -> list[str]:
    """Parts of a kind between two nets."""
    return [ref for ref, part in PARTS.items() if part.kind == kind and ends(ref) == {first, second}]


def test_references_are_used_once_and_each_net_joins_something() -> None:
    assert len(PARTS) == len(circuit.PARTS)
    assert [net for net, pins in NETS.items() if len(pins) < 2] == []


def test_pins_of_the_pico_are_those_of_the_firmware() -> None:
    """Each signal of pins.h is the net at its pin of the board; no other GPIO is used."""
    found = dict(re.findall(r"PIN_(\w+) = (\d+)", (FIRMWARE / "pins.h").read_text()))
    found.pop("LED")
    wired = {net: name for name, net in PARTS["U1"].pins if name.startswith("GP") and net}
    assert wired == {name: f"GP{number}" for name, number in found.items()}
    for pin, name in enumerate((name for name, _ in PARTS["U1"].pins), 1):
        assert circuit.BOARD_PIN.get(int(name[2:]) if re.fullmatch(r"GP\d+", name) else -1, pin) == pin


@pytest.mark.parametrize(
    ("net", "pins"),
    [
        ("5V", "C1.1 C7.1 D1.1 F1.2 SW1.1 U3.8"),
        ("HAND", "Q1.2 R1.1 SW1.2"),
        ("GATE_A", "Q1.1 Q2.3 R1.2"),
        ("BETWEEN", "Q2.2 Q3.3"),
        ("CHAIN", "Q1.3 Q4.2 R4.1"),
        ("GATE_B", "Q4.1 Q5.3 R4.2"),
        ("LASER_PLUS", "J1.1 Q4.3 R6.1"),
        ("ALIVE", "Q3.1 R3.1 U2.13"),
        ("LIGHT", "R11.2 R12.1 U1.7 U3.1"),
        ("SEEN", "C6.1 D3.2 R10.1 R12.2 U3.3"),
    ],
)
def test_nets_of_the_laser(net: str, pins: str) -> None:
    """Those on which darkness depends, pin by pin, written a second time."""
    assert sorted(f"{ref}.{pin}" for ref, pin in NETS[net]) == pins.split()


def lit(driven: dict[str, bool]) -> bool:
    """State of the laser: nets that are driven, resistors that pull the others, transistors that conduct."""
    high, low = {"5V", "VBUS", "HAND"}, {"GND"}
    high |= {net for net, level in driven.items() if level}
    low |= {net for net, level in driven.items() if not level}

    def pulled(net: str, to: set[str]) -> bool:
        return net in to or any(bridges("R", net, other) for other in to)

    for _ in PARTS:
        for ref in ("Q2", "Q3", "Q5"):
            (_, gate), (_, source), (_, drain) = PARTS[ref].pins
            # A gate that floats without a resistor to ground may be high.
            if not pulled(gate, low - {gate}) or gate in high:
                low |= {drain} if source in low else set()
        for ref in ("Q1", "Q4"):
            (_, gate), (_, source), (_, drain) = PARTS[ref].pins
            if source in high and (gate in low or not pulled(gate, high)):
                high.add(drain)
    return "LASER_PLUS" in high


def test_the_laser_shines_by_three_signals_and_by_nothing_less() -> None:
    """Each of LASER, SUPPLY and ALIVE high, low or floating: lit only where all are high."""
    names = ("LASER", "SUPPLY", "ALIVE")
    for levels in itertools.product((True, False, None), repeat=3):
        driven = {name: level for name, level in zip(names, levels, strict=True) if level is not None}
        assert lit(driven) == (levels == (True, True, True)), driven


@pytest.mark.parametrize("missing", ["R1", "R2", "R3", "R4", "R5"])
def test_a_pull_resistor_that_is_left_out_is_noticed(missing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test above depends on each of them."""
    monkeypatch.delitem(PARTS, missing)
    with pytest.raises(AssertionError):
        test_the_laser_shines_by_three_signals_and_by_nothing_less()


@pytest.mark.parametrize(
    ("ref", "supply"), [("U1", "VBUS"), ("U1", "3V3"), ("U2", "3V3"), ("U3", "5V"), ("U4", "VM"), ("U4", "3V3")]
)
def test_supplies_are_decoupled(ref: str, supply: str) -> None:
    """A capacitor from each supply of each part to ground, as many as parts that it feeds."""
    assert supply in ends(ref)
    fed = [name for name in PARTS if name[0] == "U" and supply in ends(name)]
    assert len(bridges("C", supply, "GND")) >= len(fed)


def test_no_input_floats() -> None:
    """Each input is tied to a supply or has a resistor, unless an output drives it all the time."""
    fixed = {"GND", "3V3", "5V"}
    driven = {"THRESHOLD"}  # by the trimmer's wiper
    inputs = {
        "U2": ("/A1", "B1", "/R1", "/A2", "B2", "/R2"),
        "U3": ("IN1+", "IN1-", "IN2+", "IN2-"),
        "U4": ("EN", "MS1", "MS2", "PDN", "CLK", "STEP", "DIR"),
        "U1": ("GP5", "GP9", "GP11", "GP12"),
    }
    for ref, names in inputs.items():
        for name in names:
            net = dict(PARTS[ref].pins)[name]
            assert net is not None
            pulled = any(bridges("R", net, level) for level in fixed)
            assert net in fixed | driven or pulled, f"{ref} {name} floats"


def test_the_fuse_and_the_switch_stand_before_everything_of_the_laser() -> None:
    """VBUS reaches nothing but the Pico, its capacitor and the fuse; the chain nothing but the switch."""
    assert {ref for ref, _ in NETS["VBUS"]} == {"U1", "C9", "F1"}
    assert {ref for ref, _ in NETS["HAND"]} == {"SW1", "Q1", "R1"}


def test_the_monostable_reads_what_the_pico_gives() -> None:
    """Supplied from 3.3 V, retriggered by rising edges of HEARTBEAT."""
    pins = dict(PARTS["U2"].pins)
    assert (pins["VCC"], pins["/A1"], pins["B1"], pins["Q1"]) == ("3V3", "GND", "HEARTBEAT", "ALIVE")


def test_the_sun_is_no_laser_that_is_stuck_on() -> None:
    """With the band-pass: a third of the threshold. Without: above it, as the page says."""
    full, floor = head.photodiode(), head.photodiode(400.0)
    assert 3 * full["sun"] < full["threshold"] < full["sun without filter"]
    page = BUILD.read_text()
    for current in (full["laser"], full["threshold"]):
        assert f"{1e6 * current:.0f} uA" in page
    assert f"{1e6 * full['sun']:.1f} uA" in page and f"{1e6 * floor['sun']:.1f} uA" in page
    assert f"{1e6 * full['sun without filter']:.0f} uA" in page
    assert f"{full['laser'] * 22e3:.2f} V" in page


def test_lens_and_filter_are_those_of_the_page() -> None:
    across, along = head.field()
    assert f"{across:.0f} x {along:.0f} degrees" in BUILD.read_text()
    assert 1.0 - head.filter_shift(0.5 * across * 3.14159 / 180) == pytest.approx(0.04, abs=0.005)


def parse(text: str) -> list[Any]:
    """S-expression of a file as nested lists."""
    stack: list[list[Any]] = [[]]
    for quoted, bracket, word in re.findall(r'"((?:[^"\\]|\\.)*)"|([()])|([^\s()"]+)', text):
        if bracket == "(":
            stack.append([])
        elif bracket == ")":
            done = stack.pop()
            stack[-1].append(done)
        else:
            stack[-1].append(word or quoted)
    assert len(stack) == 1, "brackets do not match"
    return list(stack[0][0])


def below(node: list[Any], name: str) -> list[list[Any]]:
    return [child for child in node if isinstance(child, list) and child and child[0] == name]


def test_the_schematic_has_the_nets_of_the_table() -> None:
    """Read back: the label or the cross that stands at the end of each pin."""
    tree = parse(wiring.files()[wiring.DOCS / "hardware" / "guara_board.kicad_sch"])
    symbols = {symbol[1]: symbol for symbol in below(below(tree, "lib_symbols")[0], "symbol")}
    labels = {tuple(map(float, below(label, "at")[0][1:3])): label[1] for label in below(tree, "global_label")}
    crosses = {tuple(map(float, below(cross, "at")[0][1:3])) for cross in below(tree, "no_connect")}
    found: dict[str, list[str | None]] = {}
    for symbol in below(tree, "symbol"):
        x, y = map(float, below(symbol, "at")[0][1:3])
        ref = next(value[2] for value in below(symbol, "property") if value[1] == "Reference")
        body = symbols[below(symbol, "lib_id")[0][1]]
        pins = [pin for unit in below(body, "symbol") for pin in below(unit, "pin")]
        found[ref] = []
        for pin in pins:
            at = below(pin, "at")[0]
            place = (round(x + float(at[1]), 2), round(y - float(at[2]), 2))
            assert (place in labels) != (place in crosses)
            found[ref].append(labels.get(place))
    assert found == {ref: [net for _, net in part.pins] for ref, part in PARTS.items()}


def test_places_of_the_sheet_do_not_overlap() -> None:
    _, places = wiring.sheet()
    taken = [(place.x, place.y + row) for place in places for row in range(-1, 2 * place.rows)]
    assert len(taken) == len(set(taken))


def test_every_part_is_bought() -> None:
    """The list holds each reference once, with its quantity and three classes."""
    rows = list(csv.DictReader(wiring.files()[wiring.DOCS / "hardware" / "bom.csv"].splitlines()))
    refs = [ref for row in rows for ref in row["reference"].split()]
    assert sorted(refs) == sorted([*PARTS, *(part.ref for part in head.HEAD)])
    assert all(int(row["quantity"]) == len(row["reference"].split()) and all(row.values()) for row in rows)


@pytest.mark.parametrize("path", sorted(wiring.files()), ids=lambda path: path.name)
def test_files_are_made_of_the_table(path: Any) -> None:
    """`python firmware/wiring.py` writes what is committed."""
    assert path.read_text(encoding="utf-8") == wiring.files()[path]
