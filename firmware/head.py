"""The optical head: parts that are not wired, the light at the photodiode, and the mechanical drawing.

Places come from the robot's URDF and robot.toml, errors from the table of docs/build.md.
"""

from __future__ import annotations

import math
import re
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from xml.sax.saxutils import escape

from circuit import Part

TOP = Path(__file__).resolve().parents[1]
ROBOT = TOP / "robots" / "guara"


def _bought(ref: str, value: str, form: str, look_for: str, *makers: str) -> Part:
    first, second, third = makers
    return Part(ref, value, form, look_for, (first, second, third), (), "head")


HEAD = (
    _bought(
        "X1", "line laser, class 2", "12 x 35 mm, 5 V",
        "class 2 and its label by the maker, fan 90 degrees, 635 to 660 nm, lit and dark 1 ms after its supply",
        "Picotronic class 2 lines", "Laser Components FLEXPOINT", "Global Laser class 2 lines",
    ),
    _bought(
        "M1", "stepper NEMA 8", "20 x 20 mm, 4 mm shaft", "1.8 degrees, 0.2 to 0.6 A, 10 mN m at 230 full steps/s",
        "Nanotec ST2018", "Stepperonline 8HS", "Trinamic QSH2018",
    ),
    _bought(
        "X2", "mirror 20 x 20 mm", "1 to 2 mm thick", "first surface, flat to 4 waves",
        "Edmund first surface", "Thorlabs ME", "Laser scrap: first surface only",
    ),
    _bought(
        "X3", "slotted optical switch", "slot 3 to 5 mm",
        "slit 0.5 mm, repeats to 10 um: with a vane of 57 mm, 0.01 degrees",
        "Omron EE-SX", "TT Electronics OPB", "Vishay TCST",
    ),
    _bought(
        "X4", "vane", "carbon rod 1 mm, 57 mm long",
        "below 2 g cm2 with its flag of 0.05 g",
        "any model shop", "any kite shop", "own work",
    ),
    _bought(
        "X5", "camera", "USB or GigE",
        "global shutter, monochrome, 1/4 inch, 1280 x 800 (OV9281), M12 mount, 120 frames/s",
        "Arducam OV9281 UVC", "Innomaker OV9281 UVC", "any GenICam with trigger",
    ),
    _bought(
        "X6", "lens 3.2 mm", "M12 x 0.5",
        "2.8 to 3.2 mm before 1/4 inch: 62 x 41 degrees or more; F/2.0 to F/2.8; distortion below 5 %",
        "Arducam M12", "Lensation BM", "Edmund M12 uVideo",
    ),
    _bought(
        "X7", "band-pass filter", "25 mm, 1 to 3 mm thick",
        "passes from the laser's wavelength to 25 nm above it, 45 to 60 nm wide",
        "MidOpt BP660", "Edmund 660 nm / 50 nm", "Thorlabs FB660 (40 nm or more)",
    ),
    _bought(
        "X8", "band-pass for D3", "5 x 5 mm film or glass", "as X7; a dark red gel does not do: it passes the infrared",
        "MidOpt BP660", "Edmund 660 nm / 50 nm", "cut from X7's twin",
    ),
    _bought(
        "X9", "hub for the mirror", "bore 4 mm",
        "clamps the shaft, a flat for the mirror's back whose face comes within 1 mm of the axis, below 1 g cm2",
        "Ruland clamp collar, filed flat", "Misumi shaft collar, filed flat", "printed, with an M2 clamp screw",
    ),
    _bought(
        "X10", "motor supply", "to J2", "5 to 12 V, 1 A, insulated from the mains",
        "Mean Well GST", "XP Power VEC", "step-down from the robot's battery",
    ),
)  # fmt: skip
# Metres: lens of the laser before the mirror's axis, side of the mirror, window in the floor of the black box (x, y).
LENS_TO_AXIS, MIRROR, WINDOW = 0.015, 0.020, (0.015, 0.032)


def photodiode(irradiance: float = 1000.0) -> dict[str, float]:
    """Calculate the photodiode's current [A] from the laser and, with the laser off, from the sun.

    Args:
        irradiance: on the window of the black box, which looks down [W/m^2]: 1000 by full sun, 400 by a bright floor.

    Returns:
        "laser", "threshold", "sun" with the band-pass and "sun without filter".
    """
    # A/W at 650 nm; in the infrared, where half of the sun is, up to 0.62: data sheets of the BPW34.
    responsivity, highest = 0.40, 0.62
    # 0.9 mW, spread evenly over the 32 mm that a fan of 90 degrees has 16 mm away, of which the diode is 2.65 mm wide.
    laser = 0.9e-3 * 2.65 / 32.0 * responsivity
    # The diode looks at the laser, its back to the window. Of the light in the window, black paint scatters 5 %
    # evenly into the half-space, and 7.5 mm2 of diode 20 mm away see their share.
    power = irradiance * WINDOW[0] * WINDOW[1] * 0.05 * 7.5e-6 / (math.pi * 0.020**2)
    # The band-pass leaves 50 nm of the 1.5 W/m2/nm that 1000 W/m2 of sun have at 650 nm.
    filtered = power * 50 * 1.5 / 1000.0 * responsivity
    return {"laser": laser, "threshold": laser / 2, "sun": filtered, "sun without filter": power * highest}


def filter_shift(angle: float, index: float = 1.9) -> float:
    """Calculate by which factor the pass band of an interference filter moves at an angle [rad] to its normal."""
    return math.sqrt(1.0 - (math.sin(angle) / index) ** 2)


def field(focal_length: float = 3.2, width: float = 3.84, height: float = 2.40) -> tuple[float, float]:
    """Calculate the field of view [degrees] of a lens before an OV9281 (mm)."""
    across, along = (2 * math.degrees(math.atan(side / 2 / focal_length)) for side in (width, height))
    return across, along


def places() -> dict[str, tuple[float, float]]:
    """Return x and z in base_link [m] of mirror axis and camera, from the robot's URDF."""
    tree = ElementTree.parse(ROBOT / "urdf" / "guara.urdf")
    found = {}
    for joint, name in (("laser_joint", "mirror"), ("camera_joint", "camera")):
        origin = tree.find(f"joint[@name='{joint}']/origin")
        assert origin is not None
        x, _, z = map(float, origin.attrib["xyz"].split())
        found[name] = (x, z)
    return found


def errors() -> list[tuple[str, ...]]:
    """Return the rows (change, median error, scatter) of the table of errors in docs/build.md."""
    page = (TOP / "docs" / "build.md").read_text(encoding="utf-8")
    return re.findall(r"^\| ([^|]+) \| ([\d.]+ mm) \| ([\d.]+ mm) \|", page, re.MULTILINE)


def _text(x: float, y: float, text: str, anchor: str = "start", size: int = 12, more: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="{size}" {more}>{escape(text)}</text>'


def _line(
    a: tuple[float, float], b: tuple[float, float], colour: str = "#333", width: float = 1.5, dash: str = ""
) -> str:
    dashed = f' stroke-dasharray="{dash}"' if dash else ""
    return f'<path d="M{a[0]:.1f},{a[1]:.1f}L{b[0]:.1f},{b[1]:.1f}" stroke="{colour}" stroke-width="{width}"{dashed}/>'


def _measure(a: tuple[float, float], b: tuple[float, float], text: str) -> list[str]:
    """Dimension line from a to b, horizontal or vertical, with its text beside it."""
    level = a[1] == b[1]
    ticks = [_line((x - 4, y + 4), (x + 4, y - 4), "#06c") for x, y in (a, b)]
    middle = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
    at = (middle[0], a[1] - 6) if level else (a[0] + 7, middle[1] + 4)
    return [_line(a, b, "#06c", 1), *ticks, _text(*at, text, "middle" if level else "start", 12, 'fill="#06c"')]


def _side_view() -> list[str]:
    """Head over the floor, seen from the robot's right: x to the right, z upwards."""
    robot = tomllib.loads((ROBOT / "robot.toml").read_text(encoding="utf-8"))
    scan, floor = robot["scan"], -robot["postures"]["scan"]["hip_height"]
    place = places()

    def at(x: float, z: float) -> tuple[float, float]:
        return 60 + (x - 0.34) * 640, 130 - (z - 0.14) * 640

    mirror, camera = at(*place["mirror"]), at(*place["camera"])
    out = [
        _text(
            30,
            30,
            "Side view (x forward, z up; base_link; metres, +-1 mm and +-1 degree: calibration measures it)",
            size=14,
        ),
        _line(at(0.34, floor), at(1.02, floor), width=2),
        _text(*at(0.80, floor - 0.035), "floor in the scan posture", size=11),
    ]
    drop = place["mirror"][1] - floor
    for angle, name in ((scan["mirror_angle_first"], "first"), (0.0, "zero"), (scan["mirror_angle_last"], "last")):
        foot = at(place["mirror"][0] + drop * math.tan(2 * angle), floor)
        out += [_line(mirror, foot, "#b00020", 1.5, "" if name != "zero" else "5 4")]
        out.append(
            _text(foot[0], foot[1] - 8, f"{name} {math.degrees(2 * angle):.1f}°", "middle", 11, 'fill="#b00020"')
        )
    half = math.radians(field()[1] / 2)
    for turn in (-half, half):
        angle = math.radians(31) + turn
        out.append(
            _line(
                camera, at(place["camera"][0] + (place["camera"][1] - floor) * math.tan(angle), floor), "#393", 1, "3 3"
            )
        )
    out += [
        _text(camera[0] + 8, camera[1] - 14, "camera, 31° from the vertical", size=12),
        f'<circle cx="{camera[0]:.1f}" cy="{camera[1]:.1f}" r="6" fill="#393"/>',
        f'<circle cx="{mirror[0]:.1f}" cy="{mirror[1]:.1f}" r="6" fill="#b00020"/>',
        _text(mirror[0] + 12, mirror[1] - 8, "axis of the mirror, parallel to y", size=12),
    ]
    (mx, mz), (cx, cz) = place["mirror"], place["camera"]
    low, right = at(0, 0.06)[1], at(mx, 0)[0] + 320
    out += _measure((camera[0], low), (mirror[0], low), f"{mx - cx:.3f}")
    out += _measure((right, camera[1]), (right, mirror[1]), f"{cz - mz:.3f}")
    out += _measure((right, mirror[1]), (right, at(0, floor)[1]), f"{mz - floor:.3f}")
    return out


def _head_view() -> list[str]:
    """The black box from the robot's right, ten times as large as the side view."""
    config = (TOP / "firmware" / "config.h").read_text(encoding="utf-8")
    nanorad, low = (
        int(re.findall(rf"{name} = (?:MIN_STEP \+ )?(\d+)", config)[0]) for name in ("STEP_NANORAD", "ZERO_STEP")
    )
    below, half, lens = math.degrees(low * nanorad * 1e-9), 1e3 * MIRROR / 2, 1e3 * LENS_TO_AXIS
    fan = 2 * lens * math.tan(math.radians(30))

    def at(x: float, z: float) -> tuple[float, float]:
        return 320 + x * 7.5, 620 - z * 7.5

    red, x, y = "#b00020", *at(-lens - 20, 6)
    out = [
        _text(
            30, 500, "Laser and mirror at zero (mm; from the robot's right; a closed box, matt black inside)", size=14
        ),
        _line(at(-lens, 0), at(0, 0), red, 2),
        _line(at(0, 0), at(0, -20), red, 2),
        _line(at(-half * 0.707, half * 0.707), at(half * 0.707, -half * 0.707), "#57a", 5),
        f'<rect x="{x:.1f}" y="{y:.1f}" width="150" height="90" fill="#ddd" stroke="#333"/>',
        _text(x + 75, y + 40, "X1 laser, shines", "middle"),
        _text(x + 75, y + 56, "forward, level +-1°", "middle"),
    ]
    for start, end in (((-36, -13), (-4, -13)), ((11, -13), (15, -13)), ((15, -13), (15, 12)), ((15, 12), (-36, 12))):
        out.append(_line(at(*start), at(*end), "#111", 4))
    x, y = at(1, 0)
    out.append(f'<rect x="{x - 8:.1f}" y="{y - 19:.1f}" width="16" height="38" fill="#fd6" stroke="#333"/>')
    notes = (
        (10, "X2 mirror 20 x 20, first surface towards the laser, on the axis +-0.5; M1 beyond it (+y)"),
        (6, "D3 and X8 at x = 1, y = -13, in the sheet, beside the mirror: the fan's edge"),
        (4, "(36 to 42 degrees) falls on it; it looks back at X1, through a tube of 6"),
        (0, "front wall: should the mirror come off, the sheet ends here and not in an eye"),
        (-4, "X3 and X4: vane of 57 on the mirror's hub, in the slot above step 0;"),
        (-6, f"step 0 is {below:.0f}° of mirror below zero (+-2°), 2° are free below it"),
        (-10, f"the middle 60° of the fan are {fan:.1f} wide on the mirror of {2 * half:.0f}"),
        (
            -15,
            f"window {1e3 * WINDOW[0]:.0f} (x -4 to 11) by {1e3 * WINDOW[1]:.0f}: beyond 40° forward nothing leaves",
        ),
    )
    out += [_text(at(17, 0)[0], at(0, z)[1], text, size=11) for z, text in notes]
    y = at(0, -16)[1]
    return out + _measure((at(-lens, 0)[0], y), (at(0, 0)[0], y), f"{lens:.0f} +-0.5")


def drawing() -> str:
    """Return the mechanical drawing as SVG."""
    out = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1000 770" font-family="sans-serif" fill="none">',
        '<rect width="1000" height="770" fill="white"/>',
        '<g fill="#111">',
        *_side_view(),
        *_head_view(),
        _text(640, 110, "Moved after calibration: error of heights (scatter)", size=13),
    ]
    for number, (change, median, scatter) in enumerate(errors()):
        out.append(_text(640, 135 + 20 * number, f"{change}: {median} ({scatter})", size=11))
    return "\n".join([*out, "</g>", "</svg>"]) + "\n"
