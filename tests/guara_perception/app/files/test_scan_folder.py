"""Scan folders: a valid one opens, and every invalid field is refused with file and field."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.scan_folder import ScanFolderWriter, open_scan_folder, read_picture


def test_good_folder_says_what_was_recorded(data: Path):
    """Every field of scan.json is read, with the stripes in recorded order."""
    written = json.loads((data / "scans" / "tilt" / "scan.json").read_text())
    scan = open_scan_folder(data / "scans" / "tilt")
    assert (scan.robot, scan.mode, scan.stamp, scan.step) == tuple(
        written[n] for n in ("robot", "mode", "stamp", "step")
    )
    assert [(s.index, s.mirror_angle, s.on, s.off) for s in scan.stripes] == [
        (s["index"], s["mirror_angle"], s["on"], s["off"]) for s in written["stripes"]
    ]
    assert scan.stance.to_dict() == written["stance"]
    assert scan.stance_end is None and scan.calibration_hash is None
    assert scan.source.endswith("tilt/scan.json")


def test_optional_fields_are_read(edited_scan):
    """A second stance, a hash and stamps of single stripes."""

    def change(content):
        content["stance_end"] = {**content["stance"], "gravity_in_base": None}
        content["calibration_hash"] = "abc"
        content["stripes"][3]["stamp"] = 17

    scan = gp.open_scan(edited_scan(change))
    assert scan.stance_end is not None and scan.stance_end.gravity_in_base is None
    assert scan.calibration_hash == "abc"
    assert scan.stripes[3].stamp == 17 and scan.stripes[2].stamp is None


def test_frames_are_read_one_by_one(data: Path, monkeypatch: pytest.MonkeyPatch):
    """Opening reads no image; a shared laser-off frame is read once, and so is each laser-on frame."""
    read: list[str] = []

    def counted(path: Path):
        read.append(path.name)
        return read_picture(path)

    monkeypatch.setattr("guara_perception.app.files.scan_folder.read_picture", counted)
    scan = open_scan_folder(data / "scans" / "paper")
    assert read == []
    for _, on, off in scan.frames():
        assert on.shape == (512, 640, 3) and on.dtype == np.uint8 and off is not None and off.shape == on.shape
    assert read == ["off_000.jpg", *(f"on_{k:03d}.jpg" for k in range(35))]


def test_null_off_frame_means_none(edited_scan):
    """A stripe without a laser-off frame yields None for it."""
    folder = edited_scan(lambda content: content["stripes"][0].update(off=None))
    _, _, off = next(gp.open_scan(folder).frames())
    assert off is None


BAD_FIELDS = {
    "no format": (lambda c: c.pop("format"), "format is missing"),
    "another format": (lambda c: c.update(format="guara-scan/2"), "format is 'guara-scan/2', allowed: 'guara-scan/1'"),
    "format of a calibration": (lambda c: c.update(format="guara-calibration/1"), "allowed: 'guara-scan/1'"),
    "no robot": (lambda c: c.pop("robot"), "robot is missing"),
    "robot a number": (lambda c: c.update(robot=7), "robot is a whole number; it must be text"),
    "unknown mode": (lambda c: c.update(mode="fine"), "mode is 'fine', allowed: 'coarse', 'standard'"),
    "no stamp": (lambda c: c.pop("stamp"), "stamp is missing"),
    "negative stamp": (lambda c: c.update(stamp=-1), "stamp is -1, allowed: 0 ... "),
    "stamp in seconds": (lambda c: c.update(stamp=1.7e9), "stamp is a number; it must be a whole number"),
    "stamp beyond 64 bits": (lambda c: c.update(stamp=2**63), f"stamp is {2**63}, allowed: 0 ... {2**63 - 1}"),
    "step a text": (lambda c: c.update(step="1"), "step is text; it must be a whole number"),
    "step null": (lambda c: c.update(step=None), "step is null; a value is needed"),
    "stripes an object": (lambda c: c.update(stripes={}), "stripes is an object; it must be a list"),
    "no stripe": (lambda c: c.update(stripes=[]), "the scan has no stripe"),
    "stripe a number": (lambda c: c["stripes"].insert(1, 5), "stripes[1] is a whole number; it must be an object"),
    "stripe without index": (lambda c: c["stripes"][2].pop("index"), "stripes[2].index is missing"),
    "index a fraction": (
        lambda c: c["stripes"][2].update(index=1.5),
        "stripes[2].index is a number; it must be a whole",
    ),
    "index negative": (lambda c: c["stripes"][2].update(index=-2), "stripes[2].index is -2, allowed: 0 ... 9999"),
    "index twice": (
        lambda c: c["stripes"][2].update(index=2),
        "stripe index 2 is listed 2 times; each may be listed once",
    ),
    "angle NaN": (lambda c: c["stripes"][4].update(mirror_angle=float("nan")), "stripes[4].mirror_angle is nan"),
    "angle in degrees": (
        lambda c: c["stripes"][4].update(mirror_angle=12.0),
        "mirror_angle is 12.0, allowed: -3.15 ... 3.15",
    ),
    "no on": (lambda c: c["stripes"][0].pop("on"), "stripes[0].on is missing"),
    "on null": (lambda c: c["stripes"][0].update(on=None), "stripes[0].on is null; a value is needed"),
    "no off": (lambda c: c["stripes"][0].pop("off"), "stripes[0].off is missing; allowed: a frame name or null"),
    "off a number": (lambda c: c["stripes"][0].update(off=3), "stripes[0].off is a whole number; it must be text"),
    "frame not there": (
        lambda c: c["stripes"][5].update(on="x.png"),
        "stripe index 10 names frame x.png, which does not exist",
    ),
    "off not there": (
        lambda c: c["stripes"][5].update(off="y.png"),
        "stripe index 10 names frame y.png, which does not exist",
    ),
    "no stance": (lambda c: c.pop("stance"), "stance is missing"),
    "stance a list": (lambda c: c.update(stance=[]), "stance is a list; it must be an object"),
    "no joints": (lambda c: c["stance"].pop("joint_positions"), "stance.joint_positions is missing"),
    "joint NaN": (lambda c: c["stance"]["joint_positions"].update(lf_haa_joint=float("nan")), "lf_haa_joint is nan"),
    "joint a text": (
        lambda c: c["stance"]["joint_positions"].update(lf_haa_joint="0"),
        "stance.joint_positions.lf_haa_joint",
    ),
    "feet a text": (
        lambda c: c["stance"].update(support_feet="lf"),
        "stance.support_feet: 'lf' is not a list of leg names",
    ),
    "foot twice": (
        lambda c: c["stance"].update(support_feet=["lf", "lf", "rh"]),
        "stance.support_feet: 'lf' is named 2 times",
    ),
    "gravity up": (lambda c: c["stance"].update(gravity_in_base=[0, 0, 9.81]), "stance.gravity_in_base: z is 9.81"),
    "gravity short": (lambda c: c["stance"].update(gravity_in_base=[0, -1]), "stance.gravity_in_base: 2 numbers given"),
    "gravity zero": (lambda c: c["stance"].update(gravity_in_base=[0, 0, 0]), "stance.gravity_in_base: z is 0"),
    "unknown stance field": (lambda c: c["stance"].update(gravity=[0, 0, -1]), "stance.gravity: unknown field"),
    "bad second stance": (lambda c: c.update(stance_end={"joint_positions": {}}), "stance_end.support_feet is missing"),
    "hash a number": (lambda c: c.update(calibration_hash=1), "calibration_hash is a whole number; it must be text"),
    "infinity in a comment": (lambda c: c.update(comment=[float("inf")]), "comment[0] is inf; it must be finite"),
}


@pytest.mark.parametrize(("change", "reported"), BAD_FIELDS.values(), ids=BAD_FIELDS)
def test_bad_field_is_refused_by_name(edited_scan, change, reported: str):
    """Each message is one line with file, field, given value and what is allowed."""
    folder = edited_scan(change)
    with pytest.raises((gp.FileFormatError, gp.MissingFile)) as caught:
        gp.open_scan(folder)
    message = str(caught.value)
    assert message.startswith(str(folder / "scan.json"))
    assert reported in message and "\n" not in message


def test_missing_folder_and_missing_scan_file(tmp_path: Path):
    """A missing path, and a folder that is not a scan."""
    with pytest.raises(gp.MissingFile, match="nowhere: no such"):
        gp.open_scan(tmp_path / "nowhere")
    with pytest.raises(gp.MissingFile, match="contains no scan.json, so it is not a scan"):
        gp.open_scan(tmp_path)


def test_a_file_that_is_no_recording_is_refused(data: Path):
    """Given scan.json instead of its folder, the message explains what a scan is."""
    with pytest.raises(
        gp.InvalidInput, match="scan.json: not a scan; allowed: a folder with scan.json, or a file that ends"
    ):
        gp.open_scan(data / "scans" / "paper" / "scan.json")


def test_broken_json_is_refused(paper_copy: Path):
    """A truncated scan.json is named."""
    path = paper_copy / "scan.json"
    path.write_text(path.read_text()[:500])
    with pytest.raises(gp.FileFormatError, match="scan.json: not a JSON file"):
        gp.open_scan(paper_copy)


@pytest.mark.parametrize("content", [b"", b"no picture", b"\xff\xd8\xff\xe0"], ids=["empty", "text", "cut jpeg"])
def test_broken_frame_is_refused_when_it_is_read(paper_copy: Path, content: bytes):
    """A frame that is not an image is named, with its size."""
    (paper_copy / "on_004.jpg").write_bytes(content)
    scan = gp.open_scan(paper_copy)
    with pytest.raises(gp.FileFormatError, match=rf"on_004.jpg: not a readable picture \({len(content)} bytes\)"):
        list(scan.frames())


def test_frame_that_vanished_is_named(paper_copy: Path):
    """A frame removed after the scan was opened is reported by name."""
    scan = gp.open_scan(paper_copy)
    (paper_copy / "on_002.jpg").unlink()
    with pytest.raises(gp.MissingFile, match="on_002.jpg: no such file"):
        list(scan.frames())


@pytest.mark.parametrize(
    "picture",
    [
        np.arange(48, dtype=np.uint8).reshape(6, 8),
        np.arange(144, dtype=np.uint8).reshape(6, 8, 3),
        np.arange(48, dtype=np.uint16).reshape(6, 8) * 1000,
        np.arange(144, dtype=np.uint16).reshape(6, 8, 3) * 400,
    ],
    ids=["grey 8", "colour 8", "grey 16", "colour 16"],
)
def test_pictures_are_read_as_they_are(tmp_path: Path, picture: np.ndarray):
    """Depth and channels of a PNG stay as they were written."""
    cv2.imwrite(str(tmp_path / "picture.png"), picture)
    read = read_picture(tmp_path / "picture.png")
    assert read.dtype == picture.dtype
    np.testing.assert_array_equal(read, picture)


@pytest.mark.parametrize("name", ["/etc/hostname", "../secret.png", "frames/../../secret.png"])
def test_frames_outside_the_folder_are_refused(edited_scan, name: str):
    """A scan folder cannot make the program read files outside it."""

    def change(content):
        content["stripes"][0]["on"] = name

    with pytest.raises(gp.FileFormatError, match=r"stripe index \d+ names frame .*; allowed: a path inside the folder"):
        gp.open_scan(edited_scan(change))


def test_each_laser_off_array_has_its_file(tmp_path: Path, data: Path):
    """Freed arrays whose ids are reused get separate files; an array shared by two stripes gets one."""
    stance = gp.open_scan(data / "scans" / "paper").stance
    on, shared = np.zeros((8, 8), np.uint8), np.full((8, 8), 200, np.uint8)
    with ScanFolderWriter(tmp_path / "scan") as writer:
        for index in range(20):
            writer.add(index, 0.0, on, np.full((8, 8), index, np.uint8))
        for index in (20, 21):
            writer.add(index, 0.0, on, shared)
        writer.finish(robot="guara", mode="standard", stamp=1, step=0, stance=stance)
    stripes = open_scan_folder(tmp_path / "scan").stripes
    for stripe in stripes[:20]:
        assert stripe.off is not None
        assert read_picture(tmp_path / "scan" / stripe.off)[0, 0] == stripe.index
    assert len({stripe.off for stripe in stripes}) == 21 and stripes[20].off == stripes[21].off
