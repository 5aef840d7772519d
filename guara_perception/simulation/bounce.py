"""The second bounce in a simple form: a stripe on one surface lights the surfaces that face it."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Float32, Index, Mask
from guara_perception.simulation.scene_view import SceneView

# Bounced light is smooth: pixels per receiver each way, and sources per stripe.
RECEIVER_PX_OF_WIDTH = 1 / 64
SOURCES = 32
# Level ground cannot light level ground; only where one of the two leans by more than this is anything computed.
LEVEL_COSINE = 0.97
NEAREST_M = 0.004
FAINTEST_LEVEL = 0.2


class Bounce:
    """Receivers of one view, on a coarse grid of its pixels."""

    def __init__(self, view: SceneView) -> None:
        """Pick the receivers."""
        height, width = view.laser_gain.shape
        stride = max(int(round(width * RECEIVER_PX_OF_WIDTH)), 1)
        self._shape = (height, width)
        self._points = np.ascontiguousarray(view.points[stride // 2 :: stride, stride // 2 :: stride])
        self._normals = np.ascontiguousarray(view.normals[stride // 2 :: stride, stride // 2 :: stride])
        self._reflectance = np.ascontiguousarray(view.reflectance[stride // 2 :: stride, stride // 2 :: stride])
        self._leaning = self._normals[..., 2] < LEVEL_COSINE
        self._view = view

    def light(self, pixels: Index, level: Float32, strength: float) -> Float32 | None:
        """Levels (h, w) of bounced light, or None when there is too little of it.

        Args:
            pixels: (n,) lit pixels, flat.
            level: (n,) their levels, without speckle.
            strength: 1 = as physics has it.
        """
        view = self._view
        normals = view.normals.reshape(-1, 3)
        leaning = normals[pixels, 2] < LEVEL_COSINE
        if not leaning.any() and not self._leaning.any():
            return None
        total = np.zeros(self._leaning.shape, np.float32)
        # Sources that lean light everything; level ones only what leans.
        for chosen, receivers in ((pixels[leaning], None), (pixels[~leaning], self._leaning)):
            if not chosen.size or (receivers is not None and not receivers.any()):
                continue
            levels = level[leaning] if receivers is None else level[~leaning]
            pick = np.linspace(0, chosen.size - 1, min(SOURCES, chosen.size)).astype(np.intp)
            sources = chosen[pick]
            # The sources picked stand for all lit pixels.
            share = float(levels.sum() / max(levels[pick].sum(), 1e-6))
            sent = levels[pick] * np.float32(share)
            self._add(total, receivers, sources, sent)
        total *= np.float32(strength)
        if total.max() < FAINTEST_LEVEL:
            return None
        height, width = self._shape
        return np.asarray(cv2.resize(total, (width, height), interpolation=cv2.INTER_LINEAR))

    def _add(
        self,
        total: Float32,
        receivers: Mask | None,
        sources: Index,
        sent: Float32,
    ) -> None:
        """Add the light of sources to receivers: Lambert on both sides, falling with the square of the distance."""
        view = self._view
        where = np.ones(total.shape, bool) if receivers is None else receivers
        to_points, to_normals = self._points[where], self._normals[where]
        from_points, from_normals = view.points.reshape(-1, 3)[sources], view.normals.reshape(-1, 3)[sources]
        areas = self._pixel_areas(sources)
        # ways[i, j] = receiver i - source j, by its parts, without the (n, m, 3) array.
        cross = to_points @ from_points.T
        square = (to_points**2).sum(axis=1)[:, None] - 2 * cross + (from_points**2).sum(axis=1)
        square = np.maximum(square, np.float32(NEAREST_M**2))
        out = to_points @ from_normals.T - (from_points * from_normals).sum(axis=1)
        into = to_normals @ from_points.T - (to_points * to_normals).sum(axis=1)[:, None]
        exchange = np.maximum(out, 0) * np.maximum(into, 0) / square**2
        total[where] += self._reflectance[where] * (exchange @ (sent * areas)) / np.float32(np.pi)

    def _pixel_areas(self, sources: Index) -> Float32:
        """Area of surface (n,) that a pixel shows [m^2], bounded: beside an edge its corners lie far apart."""
        height, width = self._shape
        points = self._view.points.reshape(-1, 3)
        right = points[np.minimum(sources + 1, points.shape[0] - 1)] - points[sources]
        below = points[np.minimum(sources + width, points.shape[0] - 1)] - points[sources]
        area = np.linalg.norm(np.cross(right, below), axis=1)
        return np.minimum(area, 4 * np.float32(np.median(area))).astype(np.float32)
