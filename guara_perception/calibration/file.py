"""Reading and writing of `calibration.json`, which has a format version and a content hash."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import logging
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from guara_perception.calibration.calibration import VERDICTS, Calibration, CameraModel, StripePlane
from guara_perception.exceptions import FileFormatError, InvalidInput, errors_as
from guara_perception.fields import Fields, parse_json, read_json, refuse_not_finite
from guara_perception.files import write_text

FORMAT = "guara-calibration/1"
logger = logging.getLogger(__name__)


def load_calibration(path: str | Path) -> Calibration:
    """Read and validate a calibration file.

    The `hash` of the result is that of the content. If the file states another hash, for example after an edit by
    hand, a warning is logged.

    Raises:
        MissingFile: there is no such file, or `path` is a folder.
        FileFormatError: the file cannot be read or is too large, or the content is not a calibration.
    """
    return _validated(read_json(path), str(path))


def parse_calibration(content: bytes, source: str) -> Calibration:
    """Parse the content of a calibration file, as stored in a recording; see `load_calibration`.

    Args:
        content: content of `calibration.json`.
        source: origin of the content, for messages.

    Raises:
        FileFormatError: the content is not a calibration.
    """
    return _validated(parse_json(content, source), source)


def _validated(fields: Fields, source: str) -> Calibration:
    fields.text("format", (FORMAT,))
    with errors_as(FileFormatError, source, InvalidInput):
        calibration = _parse(fields)
    content = dataclasses.replace(calibration, hash=content_hash(calibration))
    stored = fields.text("hash") if fields.has("hash") else ""
    if stored and stored != content.hash:
        logger.warning(
            "%s: stored hash %s, content hash %s: the file was probably edited", source, stored, content.hash
        )
    return content


def save_calibration(calibration: Calibration, path: str | Path) -> Calibration:
    """Write a calibration file atomically; return the calibration as written, with `created` and `hash` filled in.

    Raises:
        MissingFile: the folder of `path` does not exist.
        InvalidInput: `path` is a folder.
        FileFormatError: a value is NaN or infinite.
        OSError: the file cannot be written.
    """
    created = calibration.created or datetime.now(UTC).isoformat(timespec="seconds")
    dated = dataclasses.replace(calibration, created=created)
    final = dataclasses.replace(dated, hash=content_hash(dated))
    write_text(path, to_json(final))
    return final


def to_json(calibration: Calibration) -> str:
    """Convert a calibration to the text of its file.

    Raises:
        FileFormatError: a value is NaN or infinite, so that the file could not be loaded again.
    """
    content = to_dict(calibration)
    refuse_not_finite(content, "calibration")
    return json.dumps(content, indent=1) + "\n"


def to_dict(calibration: Calibration) -> dict[str, Any]:
    """Convert a calibration to a JSON object, with fields in the order of docs/files.md."""
    camera = calibration.camera
    return {
        "format": FORMAT,
        "robot": calibration.robot,
        "camera": {
            "size": list(camera.size),
            "matrix": camera.matrix.tolist(),
            "distortion": camera.distortion.tolist(),
            # Omitted if unknown, so that the content hash of files older than this field stays valid.
            **({"identity": camera.identity} if camera.identity else {}),
        },
        "transform_camera_to_base": calibration.transform_camera_to_base.tolist(),
        "stripes": [
            {"index": s.index, "mirror_angle": s.mirror_angle, "plane": s.plane.tolist()} for s in calibration.stripes
        ],
        "mirror": calibration.mirror,
        "paper": calibration.paper,
        "covariance": calibration.covariance,
        "quality": dict(calibration.quality),
        "created": calibration.created,
        "hash": calibration.hash,
    }


def content_hash(calibration: Calibration) -> str:
    """Hash of a calibration without its field `hash`: first 16 hexadecimal digits of SHA-256."""
    content = to_dict(calibration)
    del content["hash"]
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _parse(fields: Fields) -> Calibration:
    camera = fields.sub("camera")
    size = camera.array("size", (2,))
    stripes = tuple(
        StripePlane(
            index=item.integer("index", minimum=0),
            mirror_angle=item.number("mirror_angle", -3.15, 3.15),
            plane=item.array("plane", (4,)),
        )
        for item in fields.items("stripes")
    )
    quality: dict[str, Any] = {"verdict": "unknown", "reasons": []}
    if fields.has("quality"):
        given = fields.sub("quality")
        quality = {**given.data, "verdict": given.text("verdict", VERDICTS)}
        quality["reasons"] = given.sequence("reasons") if given.has("reasons") else []
    return Calibration(
        robot=fields.text("robot"),
        camera=CameraModel(
            size=(size[0], size[1]),
            matrix=camera.array("matrix", (3, 3)),
            distortion=camera.array("distortion", (5,)),
            identity=camera.text("identity") if camera.has("identity") else "",
        ),
        transform_camera_to_base=fields.array("transform_camera_to_base", (4, 4)),
        stripes=stripes,
        mirror=fields.sub("mirror").data if fields.has("mirror") else None,
        paper=fields.sub("paper").data if fields.has("paper") else None,
        covariance=fields.sub("covariance").data if fields.has("covariance") else None,
        quality=quality,
        created=fields.text("created") if fields.has("created") else "",
    )
