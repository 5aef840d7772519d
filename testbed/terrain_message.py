"""Terrain messages with every field set, whose values depend on the sequence number."""

from __future__ import annotations

from typing import Any

import numpy as np

import transport

STAMP = 1_700_000_000_000_000_000


def make_stance() -> transport.StanceMessage:
    """Make a stance with every field set."""
    return transport.StanceMessage(
        joint_positions={"lf_haa_joint": 0.1, "lf_hfe_joint": -0.4},
        support_feet=("lf", "rf", "lh"),
        gravity_in_base=(0.0, 0.1, -9.8),
    )


def make_terrain(
    sequence: int = 1,
    *,
    step: int | None = None,
    shape: tuple[int, int] = (108, 90),
    stamp: int = STAMP,
    extent: str = "footprint",
    **changes: object,
) -> transport.TerrainMessage:
    """Make a grid whose values depend on its sequence number, so that a mixture of two grids would be detected."""
    rng = np.random.default_rng(sequence)
    layers: dict[str, Any] = {}
    for name, kind in transport.LAYERS.items():
        values = rng.random(shape) if kind.dtype == np.float32 else rng.integers(0, 256, shape)
        layers[name] = values.astype(kind.dtype)
    layers["variance"][:] = sequence
    layers["looks"][:] = sequence % 256
    layers["elevation"][0, 0] = np.nan
    fields: dict[str, Any] = {
        "robot": "guara",
        "extent": extent,
        "sequence": sequence,
        "step": sequence if step is None else step,
        "stamp": stamp,
        "scan_start": stamp - 2_000_000_000,
        "scan_end": stamp,
        "valid_for": 1e12,
        "valid_pauses": 4,
        "mode": "standard",
        "method": "precise",
        "calibration_hash": "abc",
        "resolution": 0.005,
        "origin": (0.5, -0.27),
        "layers": layers,
        "stance": make_stance(),
        "attitude_source": "imu",
        "transforms": (
            transport.TransformMessage(
                source_frame="base_link",
                destination_frame="base_footprint",
                matrix=np.array([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 0.36], [0, 0, 0, 1]]),
                covariance=np.diag([1.0, 2, 3, 4, 5, 6]),
            ),
            transport.TransformMessage(
                source_frame="camera_optical_frame", destination_frame="base_link", matrix=np.eye(4)
            ),
        ),
        "obstacles": (
            transport.ObstacleMessage(
                outline=np.array([[0.6, 0.0], [0.7, 0.0], [0.7, 0.1]]),
                height=0.05,
                position=(0.65, 0.05, 0.05),
                sigma=0.001,
                hazard=512,
            ),
        ),
        "point_counts": {"in": 1000, "used": 900, "dropout": 100},
        "stage_ms": {"stripes": 12.5, "finish": 30.0},
        "coverage": 0.75,
        "health": transport.Health.WARN,
        "health_reasons": ("two frames lost",),
        "metadata": '{"a": 1}',
    }
    return transport.TerrainMessage(**(fields | changes))
