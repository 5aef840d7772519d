"""Points that 3-D viewers colour: the cells of a grid by hazard, the points of stripes by their sigma."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from guara_perception.arrays import Array, Float32
from guara_perception.terrain.drawing.style import hazard_picture
from guara_perception.terrain.layers.layered_grid import LayeredGrid
from guara_perception.terrain.questions.points import known_cells

if TYPE_CHECKING:
    from guara_perception.ranging.stripe_points import StripePoints

Fields = dict[str, Array]


def cell_cloud(terrain: LayeredGrid) -> Fields:
    """A point per known cell, at its centre: x, y, z, sigma [m], hazard flags and the colour that pictures give them.

    Unknown cells have no height, and so no point: where nothing was seen nothing is drawn.
    """
    known = known_cells(terrain)
    x, y = np.meshgrid(*terrain.geometry.centres())
    colours = hazard_picture(terrain.layers["hazard"])[0][known]
    return {
        "x": x[known].astype(np.float32),
        "y": y[known].astype(np.float32),
        "z": terrain.layers["elevation"][known],
        "sigma": np.sqrt(terrain.layers["variance"][known]),
        "hazard": terrain.layers["hazard"][known],
        "rgb": packed(colours),
    }


def stripe_cloud(stripes: Mapping[int, StripePoints]) -> Fields:
    """Every point that the stripes of a scan, by index, gave in base_footprint: x, y, z, sigma [m], stripe index."""
    parts = [(index, stripe, np.isfinite(stripe.points).all(axis=1)) for index, stripe in stripes.items()]
    points = np.vstack([np.zeros((0, 3), np.float32), *(stripe.points[kept] for _, stripe, kept in parts)])
    variance = np.concatenate([np.zeros(0, np.float32), *(stripe.variance[kept] for _, stripe, kept in parts)])
    index = np.concatenate(
        [np.zeros(0, np.uint16), *(np.full(int(kept.sum()), number, np.uint16) for number, _, kept in parts)]
    )
    return {
        **{name: np.ascontiguousarray(points[:, axis]) for axis, name in enumerate(("x", "y", "z"))},
        "sigma": np.sqrt(variance).astype(np.float32),
        "stripe": index,
    }


def cloud_points(cloud: Any) -> Float32:
    """Points (n, 3) float32 of a PointCloud2 message."""
    return np.column_stack([cloud_field(cloud, name) for name in ("x", "y", "z")])


def cloud_field(cloud: Any, name: str) -> Array:
    """Values (n,) of one field of a PointCloud2 message that `point_cloud_message` made."""
    field = next(field for field in cloud.fields if field.name == name)
    kind = np.dtype({4: "<u2", 6: "<u4", 7: "<f4"}[field.datatype])
    rows = cloud.data.reshape(cloud.width, cloud.point_step)[:, field.offset : field.offset + kind.itemsize]
    return np.ascontiguousarray(rows).view(kind).reshape(-1)


def packed(colours: Array) -> Array:
    """(n,) uint32 0x00RRGGBB of (n, 3) red, green, blue 0 ... 1."""
    red, green, blue = np.rint(255.0 * colours).astype(np.uint32).T
    return np.asarray(red << 16 | green << 8 | blue, dtype=np.uint32)
