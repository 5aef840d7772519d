"""Pictures of found stripes for the documentation, good ones and bad: photographs of two families, rendered scenes.

Of the photographs only CS (MIT) and JE (CC BY-SA 4.0) may be shown. Where they are not there only the rendered pictures
are drawn.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.photograph_peers import read
from guara_perception.arrays import Image
from guara_perception.simulation import real_light
from testbed.scenes import simulated

# BGR of a position that is used, and of one that is not: seen, but doubtful.
USED, DOUBTFUL = (80, 220, 40), (40, 150, 255)
PANEL_WIDTH = 420
QUALITY = 88
STRIPES, STRIPE = 35, 17


@dataclass(frozen=True, slots=True)
class Shown:
    """A picture in which a stripe is found.

    Attributes:
        on, off: laser on, and off or None.
        along: argument `along` of `gp.extract_stripe`.
        rows: first and end row that are drawn, None for all.
    """

    on: Image
    off: Image | None
    along: str = "columns"
    rows: tuple[int, int] | None = None


PHOTOGRAPHS = {"stripes-bust": "JE/bust", "stripes-shelf": "CS/sample2", "stripes-lost": "CS/sample3"}
RENDERED: Mapping[str, Mapping[str, float]] = {
    "stripes-chessboard": {"chessboard": 1.0, "width": 0.5, "noise": 0.5, "jpeg": 1.0},
    "stripes-ghost": {"ghosts": 1.0, "clipping": 0.5, "halo": 0.5, "skirt": 1.0},
    "stripes-sun": {"ambient": 1.0},
}


def photographs(folder: Path) -> dict[str, Shown]:
    """Those that may be shown."""
    items = {f"{item['set']}/{item['name']}": item for item in json.loads((folder / "index.json").read_text())}
    shown = {}
    for name, key in PHOTOGRAPHS.items():
        item = items[key]
        on, off = (read(folder, item[which], item["colour"]) for which in ("on", "off"))
        assert on is not None
        shown[name] = Shown(on, off, item["along"])
    return shown


def rendered() -> dict[str, Shown]:
    """One stripe of the benchmark's scene in each light; that over the chessboard without a laser-off picture."""
    shown = {}
    for name, strengths in RENDERED.items():
        scan = simulated((640, 512), STRIPES, real_light(strengths))
        index, on, off = scan.frames[STRIPE]
        first, end = scan.processor().band(index)
        with_off = None if name == "stripes-chessboard" else off
        shown[name] = Shown(on, with_off, rows=(max(first - 10, 0), min(end + 10, len(on))))
    return shown


def draw(shown: Shown) -> Image:
    """The picture as delivered, beside what was found: used positions green, doubtful ones orange."""
    band = None if shown.along == "rows" or shown.rows is None else shown.rows
    profile = gp.extract_stripe(shown.on, shown.off, along=shown.along, band=band)
    grey = cv2.cvtColor(cv2.cvtColor(shown.on, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    first, end = shown.rows or (0, len(grey))
    scale = PANEL_WIDTH / grey.shape[1]
    panels = [
        np.asarray(cv2.resize(picture[first:end], None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
        for picture in (shown.on, grey)
    ]
    for positions, colour in ((profile.doubtful_px, DOUBTFUL), (profile.position_px, USED)):
        for i in np.flatnonzero(np.isfinite(positions)):
            x, y = (positions[i], i) if shown.along == "rows" else (i, positions[i])
            centre = (round(float(x) * scale), round((float(y) - first) * scale))
            cv2.circle(panels[1], centre, 1, colour, cv2.FILLED)
    return np.asarray(cv2.hconcat([panels[0], np.full((len(panels[0]), 6, 3), 255, np.uint8), panels[1]]), np.uint8)


def write(folder: Path, out: Path) -> None:
    """Write one picture for each."""
    shown = rendered()
    if (folder / "index.json").is_file():
        shown |= photographs(folder)
    else:
        print(f"{folder}: no index.json there; the photographs are not part of the repository, none is drawn")
    out.mkdir(parents=True, exist_ok=True)
    for name, each in shown.items():
        path = out / f"{name}.jpg"
        cv2.imwrite(str(path), draw(each), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        print(f"picture: {path}")
