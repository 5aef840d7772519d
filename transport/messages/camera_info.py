"""A camera as the message type that ROS 2 knows: sensor_msgs/CameraInfo."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from transport.messages.codec import make_header
from transport.messages.submessages import checked_array
from transport.messages.typestore import CAMERA_INFO, make_message


def camera_info_message(
    size: Sequence[int], matrix: npt.ArrayLike, distortion: npt.ArrayLike, frame_id: str, stamp: int
) -> Any:
    """A sensor_msgs/CameraInfo message object: model `plumb_bob`; the rectified picture has the same matrix.

    Args:
        size: width and height [px].
        matrix: (3, 3) camera matrix [px].
        distortion: (5,) k1, k2, p1, p2, k3.
        frame_id: optical frame of the camera.
        stamp: [ns] since the epoch.

    Raises:
        MessageError: a shape that does not fit, or a value that is not finite.
    """
    intrinsic = checked_array(matrix, (3, 3), "camera matrix")
    width, height = size
    return make_message(
        CAMERA_INFO,
        header=make_header(stamp, frame_id),
        height=int(height),
        width=int(width),
        distortion_model="plumb_bob",
        d=checked_array(distortion, (5,), "distortion"),
        k=intrinsic.ravel(),
        r=np.eye(3).ravel(),
        p=np.column_stack((intrinsic, np.zeros(3))).ravel(),
    )
