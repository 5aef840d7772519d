"""The robot's own body in the picture and in the light: where lines from camera or laser meet its collision shapes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float, Float32

if TYPE_CHECKING:
    from kinematics import RobotState


class Body:
    """Boxes that bound the robot's collision shapes, posed by forward kinematics."""

    def __init__(self, state: RobotState, transform_base_to_world: Float) -> None:
        """Place the shapes.

        Args:
            state: joint positions with forward kinematics done.
            transform_base_to_world: (4, 4).
        """
        boxes = []
        for name, link in state.tree.links.items():
            for shape in link.shapes:
                transform = transform_base_to_world @ state.transform_to_base(name) @ shape.transform_shape_to_link
                boxes.append((transform, _half_size(shape.kind, shape.size)))
        self._boxes = boxes

    def corners(self) -> Float:
        """Corners (n, 8, 3) of all boxes in the world."""
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        return np.array([(signs * half) @ transform[:3, :3].T + transform[:3, 3] for transform, half in self._boxes])

    def meets(self, number: int, viewpoint: Float, directions: Float32) -> tuple[Float32, npt.NDArray[np.int8]]:
        """Where lines from a viewpoint meet one box.

        Args:
            number: number of the box.
            viewpoint: (3,) position in the world [m].
            directions: (n, 3) from the viewpoint; the result is in units of their lengths.

        Returns:
            (n,) share of the direction's length at which the line enters, inf where it misses, and the axis (0, 1, 2)
            of the face.
        """
        transform, half = self._boxes[number]
        start = (viewpoint - transform[:3, 3]) @ transform[:3, :3]
        along = directions @ transform[:3, :3].astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore"):
            one, other = ((-half - start) / along).astype(np.float32), ((half - start) / along).astype(np.float32)
        near, far = np.minimum(one, other), np.maximum(one, other)
        enter = near.max(axis=1)
        hit = (enter <= far.min(axis=1)) & (enter > 0)
        return np.where(hit, enter, np.float32(np.inf)), near.argmax(axis=1).astype(np.int8)

    def normal(self, number: int, axis: npt.NDArray[np.int8], directions: Float32) -> Float32:
        """Unit normals (n, 3) in the world of the faces met, facing the viewpoint."""
        rotation = self._boxes[number][0][:3, :3].astype(np.float32)
        normals = rotation.T[axis]
        facing = np.sign(np.einsum("ni,ni->n", normals, directions))
        return np.asarray(-facing[:, None] * normals)


def _half_size(kind: str, size: tuple[float, ...]) -> Float:
    if kind == "box":
        return np.asarray(size) / 2
    if kind == "cylinder":
        return np.array([size[0], size[0], size[1] / 2])
    return np.full(3, size[0])
