"""Camera models in YAML files: reader for ROS (`camera_info`), OpenCV and Kalibr, and writer for ROS."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import CameraModel
from guara_perception.exceptions import FileFormatError, InvalidInput, errors_as
from guara_perception.fields import Fields
from guara_perception.files import existing_file, read_bounded, whole_file

MODEL = "plumb_bob"
# Field names of ROS, each with the current and earlier names in OpenCV files, in lower case without underscores.
OPENCV_NAMES = {
    "camera_matrix": ("cameramatrix", "k", "m"),
    "distortion_coefficients": ("distortioncoefficients", "distcoeffs", "d"),
    "image_width": ("imagewidth", "width"),
    "image_height": ("imageheight", "height"),
}
# Number of coefficients k1, k2, p1, p2, k3. Longer models of OpenCV begin with these; a shorter model lacks the last.
COEFFICIENTS = 5


def write_camera_info(camera: CameraModel, path: str | Path) -> Path:
    """Write a YAML file in the format of ROS's camera_calibration and camera_info_manager; return its path.

    The model is `plumb_bob` (k1, k2, p1, p2, k3, as in `CameraModel`). The rectified image has the same camera matrix.

    Raises:
        MissingFile: the folder does not exist.
        InvalidInput: `path` is a folder.
    """
    from ruamel.yaml import YAML

    content = {
        "image_width": camera.size[0],
        "image_height": camera.size[1],
        "camera_name": "camera",
        "camera_matrix": _matrix(camera.matrix),
        "distortion_model": MODEL,
        "distortion_coefficients": _matrix(camera.distortion[None]),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(np.column_stack((camera.matrix, np.zeros(3)))),
    }
    writer = YAML()
    writer.default_flow_style = None
    with whole_file(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        writer.dump(content, file)
    return Path(path)


def read_camera_info(path: str | Path) -> CameraModel:
    """Read a camera model from a YAML file written by ROS, OpenCV's FileStorage, or Kalibr with a single camera.

    Raises:
        MissingFile: the file does not exist.
        FileFormatError: the file is not YAML or contains several cameras, a field is missing or invalid, or the lens is
            a fisheye or has non-zero coefficients besides k1, k2, p1, p2, k3.
    """
    path = existing_file(path)
    content = _read_yaml(path)
    cameras = [name for name, value in content.items() if isinstance(value, dict) and "intrinsics" in value]
    with errors_as(FileFormatError, path, InvalidInput):
        if cameras:
            return _of_kalibr(content, cameras, str(path))
        return _of_ros_or_opencv(Fields(_with_ros_names(content), str(path)))


def _read_yaml(path: Path) -> dict[str, Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        # Files are normally smaller than 1 kB; YAML's aliases can expand a small file into a large object.
        text = read_bounded(path, 64 * 1024).decode()
        # OpenCV writes a directive and tags that other YAML readers reject.
        text = re.sub(r"\A%YAML:1\.0\s*\n", "", text).replace("!!opencv-matrix", "")
        content = YAML(typ="safe").load(text)
    except (YAMLError, ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: not a YAML file ({' '.join(str(error).split())[:120]})") from None
    if not isinstance(content, dict):
        raise FileFormatError(f"{path}: the top level must be a mapping with image_width, camera_matrix and so on")
    return {str(name): value for name, value in content.items()}


def _with_ros_names(content: dict[str, Any]) -> dict[str, Any]:
    plain = {name.lower().replace("_", ""): value for name, value in content.items()}
    named = {ours: plain[n] for ours, names in OPENCV_NAMES.items() for n in reversed(names) if n in plain}
    return {**content, **named}


def _of_ros_or_opencv(fields: Fields) -> CameraModel:
    if fields.has("distortion_model"):
        fields.text("distortion_model", (MODEL,))
    if fields.data.get("fisheye_model"):
        raise FileFormatError(
            f"{fields.path_to('fisheye_model')} is set; fisheye lenses are not supported; allowed: k1, k2, p1, p2, k3"
        )
    size = (fields.integer("image_width", 16), fields.integer("image_height", 16))
    matrix = fields.sub("camera_matrix").array("data", (9,)).reshape(3, 3)
    return CameraModel(size, matrix, _coefficients(fields.sub("distortion_coefficients"), "data"))


def _of_kalibr(content: dict[str, Any], cameras: list[str], source: str) -> CameraModel:
    if len(cameras) > 1:
        raise FileFormatError(
            f"{source}: contains several cameras ({', '.join(cameras)}); allowed: only that of the rangefinder"
        )
    fields = Fields(content, source).sub(cameras[0])
    fields.text("camera_model", ("pinhole",))
    fields.text("distortion_model", ("radtan",))
    width, height = fields.array("resolution", (2,))
    fu, fv, pu, pv = fields.array("intrinsics", (4,))
    matrix = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]])
    return CameraModel((width, height), matrix, _coefficients(fields, "distortion_coeffs"))


def _coefficients(fields: Fields, name: str) -> Float:
    given = fields.array(name, (None,))
    if len(given) < 4 or given[COEFFICIENTS:].any():
        raise FileFormatError(
            f"{fields.path_to(name)} has {len(given)} values; allowed: k1, k2, p1, p2 and k3; further ones must be 0"
        )
    return np.pad(given, (0, max(COEFFICIENTS - len(given), 0)))[:COEFFICIENTS]


def _matrix(values: Any) -> dict[str, Any]:
    array = np.asarray(values, dtype=np.float64)
    return {"rows": array.shape[0], "cols": array.shape[1], "data": array.ravel().tolist()}
