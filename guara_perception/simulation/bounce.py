"""Indirect light with a single bounce, from a stripe on one surface to other surfaces that face it."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Float32, Index, Mask
from guara_perception.simulation.scene_view import SceneView

# Spacing of the receivers (pixels at which bounced light is computed), relative to the image width. Few suffice,
# because bounced light varies smoothly.
RECEIVER_SPACING = 1 / 64
# Largest number of sources sampled from the lit pixels of a stripe, separately on sloped and on horizontal surfaces.
SOURCES = 32
# z of the normal below which a surface counts as sloped. Horizontal surfaces hardly illuminate each other.
SLOPED_COSINE = 0.97
# Lower bound of the distance to a source, without which the light of a point source would be unbounded.
NEAREST_M = 0.004
# Bounced light is omitted if it is below this level everywhere [grey levels]; the rounding error of a pixel is larger.
FAINTEST = 0.2


class Bounce:
    """Bounced light in one view of the scene, computed on a coarse grid of pixels (receivers)."""

    def __init__(self, view: SceneView) -> None:
        """Select the receivers; `view` is not copied."""
        height, width = view.laser_gain.shape
        stride = max(int(round(width * RECEIVER_SPACING)), 1)
        self._shape = (height, width)
        every = np.s_[stride // 2 :: stride, stride // 2 :: stride]
        self._points = np.ascontiguousarray(view.points[every])
        self._normals = np.ascontiguousarray(view.normals[every])
        self._reflectance = np.ascontiguousarray(view.reflectance[every])
        self._is_sloped = self._normals[..., 2] < SLOPED_COSINE
        self._view = view

    def light(self, pixels: Index, brightness: Float32, strength: float) -> Float32 | None:
        """Bounced light (h, w) [grey levels of 255], or None if it is fainter than FAINTEST everywhere.

        Args:
            pixels: (n,) indices of the pixels lit by the stripe, in the flat image.
            brightness: (n,) brightness of these pixels, without speckle [grey levels of 255].
            strength: factor of the bounced light; 1 = Lambert's law.
        """
        sloped = self._view.normals.reshape(-1, 3)[pixels, 2] < SLOPED_COSINE
        total = np.zeros(self._is_sloped.shape, np.float32)
        # Sloped sources light all receivers, horizontal sources only sloped receivers.
        for is_source, receivers in ((sloped, np.ones_like(self._is_sloped)), (~sloped, self._is_sloped)):
            if not is_source.any() or not receivers.any():
                continue
            chosen, values = pixels[is_source], brightness[is_source]
            pick = np.linspace(0, chosen.size - 1, min(SOURCES, chosen.size)).astype(np.intp)
            # The sampled sources are scaled to the total brightness of all lit pixels of the same kind.
            factor = float(values.sum() / max(values[pick].sum(), 1e-6))
            self._add(total, receivers, chosen[pick], values[pick] * np.float32(factor))
        total *= np.float32(strength)
        if total.max() < FAINTEST:
            return None
        height, width = self._shape
        return np.asarray(cv2.resize(total, (width, height), interpolation=cv2.INTER_LINEAR))

    def _add(self, total: Float32, receivers: Mask, sources: Index, sent: Float32) -> None:
        """Add the light of sources: reflectance / pi * source area * cosines at both ends / squared distance.

        Args:
            total: light reflected so far by each receiver [grey levels of 255]; changed in place.
            receivers: mask of the receivers to which light is added.
            sources: indices of the sources, in the flat image.
            sent: brightness of the sources [grey levels of 255].
        """
        view = self._view
        to_points, to_normals = self._points[receivers], self._normals[receivers]
        from_points, from_normals = view.points.reshape(-1, 3)[sources], view.normals.reshape(-1, 3)[sources]
        areas = self._pixel_areas(sources)
        # |a - b|^2 = |a|^2 - 2 a.b + |b|^2, and likewise below: matrix products avoid an array (receivers, sources, 3)
        # of all differences.
        dot = to_points @ from_points.T
        distance_squared = (to_points**2).sum(axis=1)[:, None] - 2 * dot + (from_points**2).sum(axis=1)
        distance_squared = np.maximum(distance_squared, np.float32(NEAREST_M**2))
        out = to_points @ from_normals.T - (from_points * from_normals).sum(axis=1)
        into = to_normals @ from_points.T - (to_points * to_normals).sum(axis=1)[:, None]
        exchange = np.maximum(out, 0) * np.maximum(into, 0) / distance_squared**2
        total[receivers] += self._reflectance[receivers] * (exchange @ (sent * areas)) / np.float32(np.pi)

    def _pixel_areas(self, sources: Index) -> Float32:
        """Area (n,) of the surface shown by each source pixel [m^2].

        The area is limited to four times the median, because a pixel at a depth edge and its neighbours are on two
        surfaces.
        """
        height, width = self._shape
        points = self._view.points.reshape(-1, 3)
        right = points[np.minimum(sources + 1, points.shape[0] - 1)] - points[sources]
        below = points[np.minimum(sources + width, points.shape[0] - 1)] - points[sources]
        area = np.linalg.norm(np.cross(right, below), axis=1)
        return np.minimum(area, 4 * np.float32(np.median(area))).astype(np.float32)
