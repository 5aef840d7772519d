"""`guara calibrate`, `gp.calibrate`, the session folder, the report and ROS camera_info."""

import base64
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app import calibrate_folder
from guara_perception.app.calibration_report import drawing
from guara_perception.app.files.calibration_session import open_session
from guara_perception.app.files.camera_info import read_camera_info, write_camera_info
from guara_perception.app.main import run
from guara_perception.calibration.calibrate_session import calibrate_session
from guara_perception.calibration.result import CalibrationResult
from tests.calibrated_session import SESSION

Edit = Callable[[dict[str, Any]], object]


@pytest.fixture
def session_copy(data: Path, tmp_path: Path) -> Callable[..., Path]:
    """A copy of the recorded session (pictures linked) whose session.json was changed by a function."""

    def make(edit: Edit = lambda content: None) -> Path:
        folder = tmp_path / "session"
        folder.mkdir()
        for entry in (data / "calibration").iterdir():
            if entry.suffix != ".json":
                (folder / entry.name).symlink_to(entry)
        content = json.loads((data / "calibration" / "session.json").read_text())
        edit(content)
        (folder / "session.json").write_text(json.dumps(content))
        return folder

    return make


@pytest.mark.slow
def test_good_session(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One command writes calibration, report and camera_info, prints every check, and exits 0."""
    out, report, lens = tmp_path / "c.json", tmp_path / "report", tmp_path / "camera.yaml"
    arguments = ["calibrate", data / "calibration", "-o", out, "--report", report, "--save-camera-info", lens]
    assert run([*map(str, arguments), "--pattern", "standard"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("verdict: good\n")
    assert re.search(r"ok +plate left out +0\.0\d+ mm", said)
    written = gp.load_calibration(out)
    assert written.indices == tuple(range(70))
    assert f"{out}: 70 stripes, verdict good, hash {written.hash}" in said
    read = read_camera_info(lens)
    np.testing.assert_array_equal(read.matrix, written.camera.matrix)
    np.testing.assert_array_equal(read.distortion, written.camera.distortion)
    page = (report / "report.html").read_text()
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert len(pictures) == 10
    for picture in pictures:
        assert cv2.imdecode(np.frombuffer(base64.b64decode(picture), np.uint8), cv2.IMREAD_COLOR).std() > 5
    assert not re.search(r"(src|href)=.(?!data:)", page), "the page must need nothing beside it"
    assert str(data) not in page
    assert [path.name for path in report.iterdir()] == ["report.html"]


def wrong_height(content: dict[str, Any]) -> None:
    """Raise the height of the median plate by 2 mm in the session."""
    content["plates"][1]["height"] = 0.042


@pytest.mark.heavy
def test_refused_session(
    session_copy: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A refused calibration exits 1, writes the report but no calibration, unless it is forced."""
    folder, out, report = session_copy(wrong_height), tmp_path / "c.json", tmp_path / "report"
    arguments = ["calibrate", str(folder), "-o", str(out)]
    made: list[CalibrationResult] = []

    def once(*arguments: Any, **more: Any) -> CalibrationResult:
        """Cache the result of a calibration, since the same pictures give the same result."""
        made.append(made[0] if made else calibrate_session(*arguments, **more))
        return made[-1]

    # Loaded before `calibrate_session` is replaced: it would keep the replacement.
    assert callable(gp.calibrate)
    monkeypatch.setattr(calibrate_folder, "calibrate_session", once)
    # The report's pictures are checked in the test above; here only its text is.
    monkeypatch.setattr(drawing, "to_png", lambda figure: b"")
    assert run([*arguments, "--report", str(report)]) == 1
    said = capsys.readouterr()
    assert said.out.startswith("verdict: refused\n")
    assert "calibration refused: plate plate_40 contradicts the others: they put its top at 40.0 mm" in said.err
    assert not out.exists()
    assert "Do not use this calibration" in (report / "report.html").read_text()
    assert run([*arguments, "--force"]) == 0
    assert gp.load_calibration(out).quality["verdict"] == "refused"
    assert len(made) == 2


@pytest.mark.slow
def test_refusal_in_python(session_copy: Callable[..., Path]) -> None:
    """`gp.calibrate` raises CalibrationRefused with the reasons."""
    folder = session_copy(lambda content: content["board"].update(square=0.025))
    with pytest.raises(gp.CalibrationRefused, match="wrong square size"):
        gp.calibrate(folder)


def drop(name: str) -> Edit:
    """Make an edit that removes a field."""
    return lambda content: content.pop(name)


BROKEN: list[tuple[Edit, str]] = [
    (drop("robot"), "session.json: robot is missing"),
    (drop("stance"), "session.json: stance is missing"),
    (lambda c: c.update(format="guara-scan/1"), "session.json: format is 'guara-scan/1', allowed"),
    (lambda c: c.update(robot="nobody"), "plate_00 was scanned by robot 'guara', but the session is from 'nobody'"),
    (lambda c: c["board"].update(inner_corners=[9]), "session.json: board.inner_corners has shape 1; it must be 2"),
    (lambda c: c["board"].update(inner_corners=[9.5, 7]), "board.inner_corners is [9.5, 7.0]; allowed: two whole"),
    (lambda c: c["board"].update(pattern="dots"), "board.pattern is 'dots', "),
    (
        lambda c: c["board"].update(pattern="charuco", inner_corners=[44, 44]),
        "a ChArUco board of 44x44 inner corners needs 1012 markers; allowed: up to 1000: use fewer and larger",
    ),
    (lambda c: c["board"].update(inner_corners=[2, 7]), "board has 2x7 inner corners"),
    (lambda c: c["board"].update(square="30 mm"), "session.json: board.square is text; it must be a number"),
    (lambda c: c["board"].update(square=30), "squares of 0.001 ... 1 m"),
    (lambda c: c["board_images"].append("board_99.jpg"), "board_99.jpg does not exist"),
    (lambda c: c["board_images"].append(3), "session.json: board_images: 3 is not a file name"),
    (lambda c: c["fiducials"].update(image="none.jpg"), "none.jpg does not exist"),
    (lambda c: c["fiducials"]["points_in_footprint"].pop(), "points_in_footprint: 3 points given; 4 or more"),
    (
        lambda c: c["fiducials"].update(points_px=[[1, 2]]),
        "points_px has shape (1, 2), it must have one [u, v]",
    ),
    (lambda c: c["plates"][0].update(height=80), "session.json: plates[0].height is 80.0, allowed: -0.5 ... 0.5"),
    (lambda c: c["plates"][0].update(scan="plate_99"), "plate_99: no such folder"),
    (lambda c: c["plates"][1].update(scan="plate_00"), "plates name the same scan twice"),
    (
        lambda c: c["stance"]["joint_positions"].pop("lf_haa_joint"),
        "plate_00 names other joints than the session: lf_haa_joint",
    ),
    (lambda c: c["stance"].pop("support_feet"), "support_feet"),
]


@pytest.mark.parametrize(("edit", "reason"), BROKEN)
def test_broken_session_file(
    session_copy: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], edit: Edit, reason: str
) -> None:
    """An invalid session file exits 2 before any work, with one line that names the field."""
    assert run(["calibrate", str(session_copy(edit)), "-o", str(tmp_path / "c.json")]) == 2
    said = capsys.readouterr().err
    assert reason in said
    assert said.count("\n") == 1
    assert not (tmp_path / "c.json").exists()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["-o", "c.txt"], "c.txt: it must end in .json"),
        (["-o", "nowhere/c.json"], "the folder nowhere does not exist"),
        (["-o", "c.json", "--save-camera-info", "lens.xml"], "lens.xml: it must end in .yaml, .yml"),
        (
            ["-o", "c.json", "--camera-info", "lens.yaml"],
            "--camera-info: lens.yaml does not exist; `guara calibrate --save-camera-info` writes such a file",
        ),
        (["-o", "c.json", "--square", "28"], "square is 28 m; allowed: 0.001 ... 1 m (28 mm are 0.028)"),
        (["-o", "c.json", "--square", "wide"], "'wide' is not a valid float"),
        (["-o", "c.json", "--distortion", "none"], "distortion is 'none', allowed: k1k2"),
    ],
)
def test_bad_options(
    data: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    reason: str,
) -> None:
    """Invalid options exit 2."""
    monkeypatch.chdir(tmp_path)
    assert run(["calibrate", str(data / "calibration"), *arguments]) == 2
    assert reason in capsys.readouterr().err


def test_no_session(tmp_path: Path) -> None:
    """A missing folder and a folder without session.json are reported as missing."""
    with pytest.raises(gp.MissingFile, match="no such folder; a calibration session is a folder with session.json"):
        open_session(tmp_path / "none")
    with pytest.raises(gp.MissingFile, match="contains no session.json, so it is not a calibration session"):
        open_session(tmp_path)


def test_report_folder_that_is_a_file(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A file given as report folder is refused before any work."""
    (tmp_path / "report").write_text("")
    arguments = [
        "calibrate",
        str(data / "calibration"),
        "-o",
        str(tmp_path / "c.json"),
        "--report",
        str(tmp_path / "report"),
    ]
    assert run(arguments) == 2
    assert "is a file; a folder is needed" in capsys.readouterr().err


def test_camera_info_as_ros_writes_it(tmp_path: Path) -> None:
    """A file of ROS's camera_calibration is read, flow lists, line breaks and all."""
    text = """image_width: 640
image_height: 512
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [589.1, 0. , 323.4,
         0. , 587.7, 251.9,
         0. , 0. , 1. ]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.24, 0.06, 1e-04, 0.0, 0.0]
"""
    (tmp_path / "ros.yaml").write_text(text)
    camera = read_camera_info(tmp_path / "ros.yaml")
    assert camera.size == (640, 512)
    np.testing.assert_array_equal(camera.matrix, [[589.1, 0, 323.4], [0, 587.7, 251.9], [0, 0, 1]])
    np.testing.assert_array_equal(camera.distortion, [-0.24, 0.06, 1e-4, 0, 0])
    again = read_camera_info(write_camera_info(camera, tmp_path / "again.yaml"))
    np.testing.assert_array_equal(again.distortion, camera.distortion)


# The lens of the recorded session, to four digits.
OPENCV = """%YAML:1.0
---
calibration_time: "Mon Nov 23 10:00:00 2026"
image_width: 640
image_height: 512
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.8910000000000002e+02, 0., 3.2340000000000000e+02, 0.,
       5.8770000000000005e+02, 2.5190000000000001e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.4090000000000000e-01, 6.0000000000000000e-02, 0., 0., 0. ]
"""
KALIBR = """cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.2409, 0.06, 0.0, 0.0]
  distortion_model: radtan
  intrinsics: [589.1, 587.7, 323.4, 251.9]
  resolution: [640, 512]
  rostopic: /camera/image_raw
"""


@pytest.mark.parametrize("text", [OPENCV, KALIBR, OPENCV.replace("camera_matrix", "cameraMatrix")])
def test_camera_of_opencv_and_kalibr(tmp_path: Path, text: str) -> None:
    """Files as written by OpenCV's FileStorage and by Kalibr give the same camera."""
    (tmp_path / "lens.yaml").write_text(text)
    camera = read_camera_info(tmp_path / "lens.yaml")
    assert camera.size == (640, 512)
    np.testing.assert_allclose(camera.matrix, [[589.1, 0, 323.4], [0, 587.7, 251.9], [0, 0, 1]])
    np.testing.assert_allclose(camera.distortion, [-0.2409, 0.06, 0, 0, 0])


def test_camera_as_opencv_itself_writes_it(tmp_path: Path) -> None:
    """A file written by cv2.FileStorage is read back unchanged."""
    matrix, lens = np.array([[589.1, 0, 323.4], [0, 587.7, 251.9], [0, 0, 1]]), np.array([[-0.24, 0.06, 1e-4, 0, 0.01]])
    storage = cv2.FileStorage(str(tmp_path / "lens.yml"), cv2.FILE_STORAGE_WRITE)
    for name, value in (("image_width", 640), ("image_height", 512), ("K", matrix), ("D", lens)):
        storage.write(name, value)
    storage.release()
    camera = read_camera_info(tmp_path / "lens.yml")
    np.testing.assert_array_equal(camera.matrix, matrix)
    np.testing.assert_array_equal(camera.distortion, lens[0])


def without_board(content: dict[str, Any]) -> None:
    """Remove the board and its pictures from a session."""
    for name in ("board", "board_images", "ground_board_image"):
        del content[name]


def one_board(content: dict[str, Any]) -> None:
    """Keep only the board picture on the floor."""
    content["board_images"] = []


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("edit", "refusal"),
    [
        (one_board, "1 of 1 board views are usable; 5 or more are needed"),
        (without_board, "has no board_images: 5 or more pictures of the board are needed, one of them with"),
    ],
)
def test_known_lens(
    session_copy: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    edit: Edit,
    refusal: str,
) -> None:
    """With a known lens, a session needs no board pictures; the lens is kept and the mount is estimated."""
    monkeypatch.setattr(drawing, "to_png", lambda figure: b"")
    folder, lens, out, report = session_copy(edit), tmp_path / "lens.yaml", tmp_path / "c.json", tmp_path / "report"
    lens.write_text(OPENCV)
    arguments = ["calibrate", str(folder), "-o", str(out)]
    assert run(arguments) == 1
    assert refusal in capsys.readouterr().err
    more = ["--camera-info", str(lens), "--not-mirrored", "--report", str(report)]
    assert run([*arguments, *more]) == 0
    said = capsys.readouterr().out
    assert said.startswith("verdict: usable") and "focal length sigma" not in said
    assert "the lens was given without its uncertainty; that of a lens estimated from 14 pictures is assumed" in said
    assert ("board corner error" in said) == (edit is one_board)
    assert ("no picture of a board verifies it" in (report / "report.html").read_text()) == (edit is without_board)
    written = gp.load_calibration(out)
    np.testing.assert_array_equal(written.camera.matrix, read_camera_info(lens).matrix)
    truth = json.loads((SESSION / "truth.json").read_text())
    assert np.linalg.norm(written.transform_camera_to_base[:3, 3] - np.array(truth["T_base_camera"])[:3, 3]) < 0.001


@pytest.mark.slow
def test_known_lens_of_other_pictures(session_copy: Callable[..., Path], tmp_path: Path) -> None:
    """A lens for another picture size is refused with both sizes; without a floor board, one is requested."""
    (tmp_path / "lens.yaml").write_text(KALIBR.replace("[640, 512]", "[1280, 1024]"))
    folder = session_copy()
    with pytest.raises(gp.CalibrationMismatch, match=r"was calibrated at 1280x1024 px, but fiducials.jpg has 640x512"):
        gp.calibrate(folder, camera_info=tmp_path / "lens.yaml")
    content = json.loads((folder / "session.json").read_text())
    del content["ground_board_image"]
    (folder / "session.json").write_text(json.dumps(content))
    with pytest.raises(gp.CalibrationRefused, match="no ground_board_image: 5 or more pictures of the board are"):
        gp.calibrate(folder)


@pytest.mark.slow
def test_square_other_than_the_session_says(session_copy: Callable[..., Path], tmp_path: Path) -> None:
    """`square` overrides the session, so that the board can be measured again without new pictures."""
    folder = session_copy(lambda content: content["board"].update(square=0.025))
    assert run(["calibrate", str(folder), "-o", str(tmp_path / "c.json"), "--square", "0.03"]) == 0
    assert gp.load_calibration(tmp_path / "c.json").quality["verdict"] != "refused"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{", "not a YAML file"),
        (
            OPENCV + "fisheye_model: 1\n",
            "fisheye_model is set; fisheye lenses are not supported; allowed: k1, k2, p1, p2, k3",
        ),
        (KALIBR.replace("radtan", "equidistant"), "cam0.distortion_model is 'equidistant', allowed: 'radtan'"),
        (KALIBR.replace("pinhole", "omni"), "cam0.camera_model is 'omni', allowed: 'pinhole'"),
        (KALIBR + KALIBR.replace("cam0", "cam1"), "contains several cameras (cam0, cam1); allowed: only that"),
        (KALIBR.replace("[-0.2409, 0.06, 0.0, 0.0]", "[-0.24]"), "has 1 values; allowed: k1, k2, p1, p2 and k3"),
        (KALIBR.replace("589.1", "-589.1"), "camera matrix must have positive focal lengths"),
        (
            OPENCV.replace("0., 0., 0. ]\n", "0., 0., 0., 0.5 ]\n"),
            "distortion_coefficients.data has 6 values; allowed: k1, k2, p1, p2 and k3; further ones must be 0",
        ),
        ("- 1", "the top level must be a mapping"),
        ("distortion_model: equidistant", "distortion_model is 'equidistant', allowed: 'plumb_bob'"),
        ("distortion_model: plumb_bob", "image_width is missing"),
        (
            "{distortion_model: plumb_bob, image_width: 64, image_height: 64, camera_matrix: {data: [1, 2]}}",
            "camera_matrix.data has shape 2; it must be 9",
        ),
    ],
)
def test_bad_camera_info(tmp_path: Path, text: str, reason: str) -> None:
    """An invalid camera_info file is refused, naming the field."""
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(gp.FileFormatError, match=re.escape(reason)):
        read_camera_info(tmp_path / "bad.yaml")
    with pytest.raises(gp.MissingFile, match="no such file"):
        read_camera_info(tmp_path / "none.yaml")
