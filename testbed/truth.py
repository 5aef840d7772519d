"""True calibration of a rendered data folder, for tests and benchmarks."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import guara_perception as gp


def truth_calibration(data: Path) -> gp.Calibration:
    """Read the true calibration of a data folder from `calibration/truth.json`.

    The k-th plane in this file belongs to the k-th stripe of the pattern; indices and mirror angles of the stripes are
    read from a complete scan in the folder.
    """
    file = data / "calibration" / "truth.json"
    if not file.is_file():
        raise SystemExit(f"{data} has no calibration/truth.json; give a data folder of rendered scans with their truth")
    truth = json.loads(file.read_text())
    planes = truth["laser_planes_camera"]
    stripes = indices_and_angles(data, len(planes))
    camera = truth["camera"]
    return gp.Calibration(
        robot="guara",
        camera=gp.CameraModel(
            size=(camera["width"], camera["height"]),
            matrix=np.array(camera["K"]),
            distortion=np.array(camera["dist"]),
        ),
        transform_camera_to_base=np.array(truth["T_base_camera"]),
        stripes=tuple(
            gp.StripePlane(index=index, mirror_angle=angle, plane=np.array(plane))
            for (index, angle), plane in zip(stripes, planes, strict=True)
        ),
        quality={"verdict": "good", "reasons": ["made from the truth of a rendering"]},
    )


def indices_and_angles(data: Path, count: int) -> list[tuple[int, float]]:
    """Read index and mirror angle of every stripe from the first scan with all stripes."""
    for path in sorted(data.glob("**/scan.json")):
        listed = json.loads(path.read_text())["stripes"]
        if len(listed) == count:
            return sorted((stripe["index"], stripe["mirror_angle"]) for stripe in listed)
    raise SystemExit(f"{data}: no scan with {count} stripes")
