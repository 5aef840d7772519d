"""Layers judged again only where something changed equal those judged all together, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.assessment.assess import assess_layers
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.assessment.reassessment import Reassessment
from guara_perception.terrain.layers.hazard import Hazard
from tests.thorough import examples

SHAPE = (30, 70)


def ground(random: np.random.Generator) -> tuple[Raster, np.ndarray]:
    """Rough ground with gaps, steep places and returns that disagree."""
    elevation = np.cumsum(random.normal(0, 0.001, SHAPE), axis=1)
    elevation[random.random(SHAPE) < random.choice([0.0, 0.02, 0.5])] = np.nan
    span = random.uniform(0, 0.004, SHAPE)
    raster = Raster(elevation, random.uniform(1e-8, 4e-5, SHAPE) + 0 * elevation, elevation - span, elevation + span)
    causes = np.where(np.isnan(elevation), random.choice([0, int(Hazard.DROPOUT), int(Hazard.OCCLUDED)], SHAPE), 0)
    return raster, causes.astype(np.uint16)


@pytest.mark.slow
@given(st.integers(0, 100_000))
@settings(max_examples=examples(80), deadline=None, derandomize=True)
def test_judged_again_as_judged_all_together(seed: int) -> None:
    """Several times some columns change, in one layer or all, or in the flags alone, or none do."""
    random = np.random.default_rng(seed)
    limits = TraversabilityLimits(
        **{
            **dict.fromkeys(("slope", "step", "drop", "roughness"), 0.02),
            "sigma": 0.005,
            "confidence": 2.0,
            "disc_radius": float(random.choice([0.005, 0.015, 0.03])),
            "sole_length": 0.04,
            "sole_width": 0.02,
        }
    )
    reassessment = Reassessment(0.005, limits)
    raster, flags = ground(random)
    for _ in range(4):
        whole = assess_layers(raster, flags, 0.005, limits)
        again = reassessment.layers(raster, flags)
        assert set(again) == set(whole)
        for name, layer in whole.items():
            assert layer.dtype == again[name].dtype and not again[name].flags.writeable
            assert layer.tobytes() == again[name].tobytes(), name
        other, other_flags = ground(random)
        columns = np.flatnonzero(random.random(SHAPE[1]) < random.choice([0.0, 0.03, 1.0]))
        kinds = random.random(4) < 0.7
        layers = [layer.copy() for layer in raster.layers]
        for changes, layer, new in zip(kinds, layers, other.layers, strict=True):
            # Where a height is known so are the others.
            layer[:, columns] = np.where(
                np.isnan(other.elevation if kinds[0] else raster.elevation)[:, columns],
                np.nan,
                np.where(np.isnan(layer) | changes, np.nan_to_num(new), layer)[:, columns],
            )
        raster, flags = Raster(*layers), flags.copy()
        flags[:, columns] = other_flags[:, columns]
