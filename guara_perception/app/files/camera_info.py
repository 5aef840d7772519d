"""Camera as ROS `camera_info` YAML."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from guara_perception.calibration.calibration import CameraModel
from guara_perception.exceptions import FileFormatError, InvalidInput
from guara_perception.fields import Fields
from guara_perception.files import existing_file, read_bounded, whole_file

MODEL = "plumb_bob"


def write_camera_info(camera: CameraModel, path: str | Path, name: str = "camera") -> Path:
    """Write the YAML that ROS's camera_calibration and camera_info_manager use; return its path.

    The model is `plumb_bob`: k1, k2, p1, p2, k3, as in `CameraModel`. The rectified picture has the same matrix.

    Raises:
        MissingFile: the folder does not exist.
    """
    from ruamel.yaml import YAML

    content = {
        "image_width": camera.size[0],
        "image_height": camera.size[1],
        "camera_name": name,
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
    """Read a camera from ROS YAML.

    Raises:
        MissingFile: no such file.
        FileFormatError: not YAML, a field is missing or impossible, or a lens model other than plumb_bob.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    path = existing_file(path)
    try:
        # camera_info of ROS has under 1 kB; YAML's aliases can make a large object of a small file.
        content = YAML(typ="safe").load(read_bounded(path, 64 * 1024).decode())
    except (YAMLError, ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: not a YAML file ({' '.join(str(error).split())[:120]})") from None
    if not isinstance(content, dict):
        raise FileFormatError(f"{path}: the top level must be a mapping with image_width, camera_matrix and so on")
    fields = Fields(content, str(path))
    fields.text("distortion_model", (MODEL,))
    size = (fields.integer("image_width", 16), fields.integer("image_height", 16))
    try:
        return CameraModel(
            size=size,
            matrix=fields.sub("camera_matrix").array("data", (9,)).reshape(3, 3),
            distortion=fields.sub("distortion_coefficients").array("data", (5,)),
        )
    except InvalidInput as error:
        raise FileFormatError(f"{path}: {error}") from None


def _matrix(values: Any) -> dict[str, Any]:
    array = np.asarray(values, dtype=np.float64)
    return {"rows": array.shape[0], "cols": array.shape[1], "data": array.ravel().tolist()}
