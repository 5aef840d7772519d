"""The calibration file: what is saved is what is loaded, its hash is that of the content, bad fields are named."""

import dataclasses
import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.calibration.file import content_hash, to_dict

FIELDS = [
    "format", "robot", "camera", "transform_camera_to_base", "stripes", "mirror", "paper", "covariance", "quality",
    "created", "hash",
]  # fmt: skip


def edited(path: Path, target: Path, change) -> Path:
    """A copy of a calibration file whose content was changed by a function."""
    content = json.loads(path.read_text())
    change(content)
    target.write_text(json.dumps(content))
    return target


def test_what_is_saved_is_loaded_bit_for_bit(calibration: gp.Calibration, calibration_file: Path):
    """Every number of the file is the number that was saved."""
    loaded = gp.load_calibration(calibration_file)
    assert loaded.camera.size == calibration.camera.size
    for name in ("matrix", "distortion"):
        assert getattr(loaded.camera, name).tobytes() == getattr(calibration.camera, name).tobytes()
    assert loaded.transform_camera_to_base.tobytes() == calibration.transform_camera_to_base.tobytes()
    assert loaded.indices == calibration.indices
    for a, b in zip(loaded.stripes, calibration.stripes, strict=True):
        assert a.mirror_angle == b.mirror_angle and a.plane.tobytes() == b.plane.tobytes()
    assert loaded.quality == calibration.quality


def test_hash_survives_saving_and_loading(calibration_file: Path, tmp_path: Path, caplog):
    """Saved, loaded and saved again, the file and its hash are the same; no warning is given."""
    loaded = gp.load_calibration(calibration_file)
    again = gp.save_calibration(loaded, tmp_path / "again.json")
    assert (tmp_path / "again.json").read_text() == calibration_file.read_text()
    assert again.hash == loaded.hash == json.loads(calibration_file.read_text())["hash"]
    assert not caplog.records


def test_hash_depends_on_every_number(calibration: gp.Calibration):
    """A change of one value in its last bit is another calibration."""
    plane = np.array(calibration.stripes[7].plane)
    plane[3] = np.nextafter(plane[3], 1)
    stripes = list(calibration.stripes)
    stripes[7] = dataclasses.replace(stripes[7], plane=plane)
    changed = dataclasses.replace(calibration, stripes=tuple(stripes))
    assert content_hash(changed) != content_hash(calibration)
    assert content_hash(dataclasses.replace(calibration, hash="else")) == content_hash(calibration)


def test_file_has_the_promised_fields(calibration_file: Path, calibration: gp.Calibration):
    """The fields have the names and the order that are documented."""
    content = json.loads(calibration_file.read_text())
    assert list(content) == FIELDS and content["format"] == "guara-calibration/1"
    assert list(content["camera"]) == ["size", "matrix", "distortion"]
    assert list(content["stripes"][0]) == ["index", "mirror_angle", "plane"]
    assert len(content["hash"]) == 16 and content["created"]
    assert list(to_dict(calibration)) == FIELDS


def test_edited_file_is_reported_and_its_own_hash_is_used(calibration_file: Path, tmp_path: Path, caplog):
    """A file that was edited is loaded with a warning, and grids carry the hash of its content."""
    path = edited(calibration_file, tmp_path / "edited.json", lambda c: c["stripes"][0].update(mirror_angle=0.1))
    with caplog.at_level(logging.WARNING):
        loaded = gp.load_calibration(path)
    stored = json.loads(path.read_text())["hash"]
    assert loaded.hash != stored and loaded.hash == content_hash(loaded)
    assert stored in caplog.text and loaded.hash in caplog.text and "the file was probably edited" in caplog.text


def test_file_without_hash_and_optional_fields_is_loaded(calibration_file: Path, tmp_path: Path, caplog):
    """A file written by hand needs neither hash, nor quality, nor the paper's constants."""

    def strip(content: dict[str, Any]) -> None:
        for name in ("hash", "created", "quality", "mirror", "paper", "covariance"):
            del content[name]

    loaded = gp.load_calibration(edited(calibration_file, tmp_path / "bare.json", strip))
    assert loaded.quality == {"verdict": "unknown", "reasons": []}
    assert loaded.mirror is None and loaded.paper is None and loaded.covariance is None
    assert loaded.hash and not caplog.records


def test_stripes_may_stand_in_any_order(calibration_file: Path, tmp_path: Path, calibration: gp.Calibration):
    """Stripes are found by index, in whatever order the file lists them."""
    loaded = gp.load_calibration(edited(calibration_file, tmp_path / "r.json", lambda c: c["stripes"].reverse()))
    assert loaded.indices == calibration.indices
    np.testing.assert_array_equal(loaded.stripe(30).plane, calibration.stripe(30).plane)


def test_index_that_was_not_calibrated_is_refused(calibration: gp.Calibration):
    """The message lists those that were."""
    with pytest.raises(gp.CalibrationMismatch, match="stripe index 31 is not in the calibration.*0, 2 ... 68"):
        calibration.stripe(31)


def nan(content: dict[str, Any], *path: Any) -> None:
    for key in path[:-1]:
        content = content[key]
    content[path[-1]] = float("nan")


BAD = {
    "another version": (lambda c: c.update(format="guara-calibration/9"), "allowed: 'guara-calibration/1'"),
    "a scan": (lambda c: c.update(format="guara-scan/1"), "format is 'guara-scan/1'"),
    "no camera": (lambda c: c.pop("camera"), "camera is missing"),
    "camera a list": (lambda c: c.update(camera=[]), "camera is a list; it must be an object"),
    "size of one": (lambda c: c["camera"].update(size=[640]), "camera.size has shape 1; it must be 2"),
    "half a pixel": (lambda c: c["camera"].update(size=[640.5, 512]), "it must be (width, height), integers"),
    "matrix 3x2": (lambda c: c["camera"].update(matrix=[[1, 0], [0, 1], [0, 0]]), "camera.matrix has shape 3x2"),
    "matrix NaN": (lambda c: nan(c, "camera", "matrix", 0, 0), "camera.matrix[0][0] is nan; it must be finite"),
    "matrix of texts": (lambda c: c["camera"].update(matrix=[["1"] * 3] * 3), "camera.matrix is not an array of 3x3"),
    "matrix zero": (lambda c: c["camera"].update(matrix=[[0] * 3] * 3), "must have positive focal lengths"),
    "four distortions": (
        lambda c: c["camera"].update(distortion=[0] * 4),
        "camera.distortion has shape 4; it must be 5",
    ),
    "no transform": (lambda c: c.pop("transform_camera_to_base"), "transform_camera_to_base is missing"),
    "not rigid": (
        lambda c: c["transform_camera_to_base"][0].__setitem__(0, 2.0),
        "transform_camera_to_base is not a rigid",
    ),
    "mirrored": (
        lambda c: c.update(transform_camera_to_base=np.diag([1.0, 1, -1, 1]).tolist()),
        "transform_camera_to_base is not a rigid transform",
    ),
    "no stripes": (lambda c: c.update(stripes=[]), "calibration has 0 stripes; 2 or more are needed"),
    "stripe twice": (lambda c: c["stripes"][1].update(index=0), "stripe index [0] more than once"),
    "index negative": (lambda c: c["stripes"][1].update(index=-1), "stripes[1].index is -1, allowed: 0 ... inf"),
    "angle in degrees": (lambda c: c["stripes"][1].update(mirror_angle=45), "stripes[1].mirror_angle is 45"),
    "plane of three": (lambda c: c["stripes"][1].update(plane=[0, 0, 1]), "stripes[1].plane has shape 3; it must be 4"),
    "plane NaN": (lambda c: nan(c, "stripes", 1, "plane", 2), "stripes[1].plane[2] is nan; it must be finite"),
    "normal of length 2": (
        lambda c: c["stripes"][1].update(plane=[0, 0, 2, 1]),
        "plane of stripe 2: the normal has length 2",
    ),
    "unknown verdict": (lambda c: c["quality"].update(verdict="fine"), "quality.verdict is 'fine', allowed: 'good'"),
    "reasons a text": (lambda c: c["quality"].update(reasons="x"), "quality.reasons is text; it must be a list"),
    "NaN in the paper's constants": (
        lambda c: c.update(paper={"H": [1, float("nan")]}),
        "paper.H[1] is nan; it must be finite",
    ),
    "NaN in a covariance": (
        lambda c: c.update(covariance={"a": float("inf")}),
        "covariance.a is inf; it must be finite",
    ),
    "hash a number": (lambda c: c.update(hash=5), "hash is a whole number; it must be text"),
    "robot null": (lambda c: c.update(robot=None), "robot is null; a value is needed"),
}


@pytest.mark.parametrize(("change", "reported"), BAD.values(), ids=BAD)
def test_bad_field_is_refused_by_name(calibration_file: Path, tmp_path: Path, change, reported: str):
    """Each message starts with the file and says field, what was given and what is allowed."""
    path = edited(calibration_file, tmp_path / "bad.json", change)
    with pytest.raises(gp.FileFormatError) as caught:
        gp.load_calibration(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and reported in message and "\n" not in message


def test_missing_file_is_refused(tmp_path: Path):
    """A file that is not there is named."""
    with pytest.raises(gp.MissingFile, match="no.json: no such file"):
        gp.load_calibration(tmp_path / "no.json")


def test_nan_is_not_saved(calibration: gp.Calibration, tmp_path: Path):
    """What could not be loaded again is not written, and an older file stays."""
    target = tmp_path / "calibration.json"
    target.write_text("old")
    broken = dataclasses.replace(calibration, covariance={"camera": [1.0, float("nan")]})
    with pytest.raises(gp.FileFormatError, match=r"covariance.camera\[1\] is nan; it must be finite"):
        gp.save_calibration(broken, target)
    assert target.read_text() == "old" and list(tmp_path.iterdir()) == [target]


def test_saving_into_a_missing_folder_is_refused(calibration: gp.Calibration, tmp_path: Path):
    """The folder to create is named."""
    with pytest.raises(gp.MissingFile, match="the folder .*nowhere does not exist; create it first"):
        gp.save_calibration(calibration, tmp_path / "nowhere" / "calibration.json")
