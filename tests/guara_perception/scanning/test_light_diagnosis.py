"""Where the light is too bad for the method, the scan's health names the effect and what to change."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pytest

from guara_perception.scanning.light_diagnosis import FrameSamples
from guara_perception.simulation import Light, real_light
from guara_perception.stripes.band import FramePair
from guara_perception.stripes.extract import extract_stripe
from testbed.scenes import simulated as simulated_scene
from tests.guara_perception.scanning import plain_samples
from tests.thorough import further

# The diagnosis of light does not depend on the uncertainty of the calibration.
simulated = partial(simulated_scene, is_uncertain=False)
# Every second stripe of a coarse scan, in pictures of a camera with a quarter of the pixels.
SIZE, STRIPES = (320, 256), 18
# The margin that each effect uses up.
MARGINS = {"too bright": "margin_clipped", "flicker": "margin_steady"}
WEAK = dataclasses.replace(real_light({"chessboard": 1.0}), laser=100.0)
LIGHTS = {
    "too bright": (real_light({"ambient": 1.0}), "% of the picture is clipped without the laser: shade the scene"),
    "bloom": (Light(laser=6000.0, stripe_sigma=0.006, leakage=(0.9, 0.9, 1.0), halo=60.0), "expose less, weaken"),
    "weak line": (WEAK, "grey levels of 255 above its surroundings: use a stronger laser"),
    "flicker": (real_light({"drift": 1.0}), "lock exposure and white balance, keep lamps steady"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["too bright", "weak line", *further("bloom", "flicker")])
def test_health_names_the_effect_of_light_and_what_to_change(name: str) -> None:
    """The last reason holds the name and the remedy, and names no other effect."""
    light, remedy = LIGHTS[name]
    # Light that drifts as much blooms too, and over a larger share of a small picture.
    scan = simulated((640, 512) if name == "flicker" else SIZE, STRIPES, light)
    processor = scan.processor()
    scan.add_to(processor)
    health = processor.finish().metadata["health"]
    reason = health["reasons"][-1]
    assert health["level"] == "degraded"
    assert f"{name}: " in reason and remedy in reason
    assert all(f"{other}: " not in reason for other in LIGHTS if other != name)
    assert name not in MARGINS or processor.light_margins[MARGINS[name]] < 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "with_off"),
    [("chessboard", False), ("chessboard", True), pytest.param("ghosts", False, marks=pytest.mark.heavy)],
)
def test_texture_is_named_where_laser_off_pictures_would_help(effect: str, with_off: bool) -> None:
    """On a chessboard most of the stripe is found even so; with laser-off pictures or on soil no texture is reported,
    and without them that motion cannot be seen.
    """
    scan = simulated((640, 512), 35, real_light({effect: 1.0}))
    processor = scan.processor()
    for index, on, off in scan.frames:
        processor.add(index, on, off if with_off else None)
    health = processor.finish().metadata["health"]
    if with_off:
        assert health == {"level": "ok", "reasons": []}
        return
    unseen, *reasons = health["reasons"]
    assert unseen.startswith("a sway of the body cannot be detected")
    assert len(reasons) == (effect == "chessboard")
    for reason in reasons:
        assert reason.startswith("texture: the scene's own light varies by ")
        assert reason.endswith(": take laser-off pictures")


@pytest.mark.slow
def test_lamps_that_flicker_strongly_are_reported_without_laser_off_pictures_too() -> None:
    """From frame to frame the picture is brighter and darker; the scan has too few returns for another reason."""
    scan = simulated(SIZE, STRIPES, dataclasses.replace(WEAK, flicker=0.3))
    processor = scan.processor()
    for index, on, _ in scan.frames:
        processor.add(index, on)
    assert "flicker: the brightness changes by " in processor.finish().metadata["health"]["reasons"][-1]


@pytest.mark.slow
@pytest.mark.parametrize("laser", [200.0, *further(1000.0, 8000.0)])
def test_a_dark_room_does_not_flicker(laser: float) -> None:
    """If only the stripe is bright, relative changes of the remaining light do not indicate flicker."""
    scan = simulated(SIZE, STRIPES, Light(ambient=(0.0, 0.0, 0.0), laser=laser))
    for with_off in (True, False):
        samples = FrameSamples([index for index, _, _ in scan.frames], scan.frames[0][1].shape[1::-1])
        for index, on, off in scan.frames:
            samples.add(FramePair(index, on, off if with_off else None), extract_stripe(on, off if with_off else None))
        assert "flicker" not in samples.excess()


@pytest.mark.slow
def test_pictures_that_were_not_used_are_reported_by_stripe() -> None:
    """The report holds each with its reason, in order; in plain light there are none."""
    for light, count in ((real_light({"drift": 1.0}), STRIPES), (Light(), 0)):
        scan = simulated(SIZE, STRIPES, light)
        processor = scan.processor()
        scan.add_to(processor)
        data = processor.finish().metadata
        unused, reported = (
            data["off_pictures_unused"],
            f"flicker: the laser-off pictures of {count} of {STRIPES} stripes",
        )
        assert any(reason.startswith(reported) for reason in data["health"]["reasons"]) == (count > 0)
        assert len(unused) == count
        margins = processor.light_margins
        assert count or min(margins.values()) > 0.0
        assert margins["stripe_level"] > 12.0
        assert [int(index) for index in unused] == sorted(int(index) for index in unused)
        assert all("laser-off picture" in why or "brightness" in why for why in unused.values())


@pytest.mark.parametrize("has_off", [True, False])
@pytest.mark.parametrize("channels", [(), (1,), (3,)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_a_sample_is_that_of_plain_array_operations(kind: type, channels: tuple[int, ...], has_off: bool) -> None:
    """A clipped line in noise, in columns far apart and close together, in pictures with any strides."""
    random = np.random.default_rng(3)
    on, off = random.integers(20, 60, (2, 275, 203, *channels)).astype(kind) * (np.iinfo(kind).max // 255)
    on[100:107, 30:170] = np.iinfo(kind).max
    off[103, 60:90] = np.iinfo(kind).max
    pair = FramePair(0, on[::-1, ::2], off[::-1, ::2] if has_off else None)
    samples = FrameSamples([0], (102, 275))
    samples.add(pair, extract_stripe(pair.on, pair.off))
    (sample,) = samples._samples.values()
    core, rows = plain_samples.look_down(pair.on, pair.off, 1, samples.columns)
    assert np.isfinite(rows).any() and np.isnan(rows).any() and core > 0
    assert sample.core == core
    np.testing.assert_array_equal(sample.rows, rows)
    scale = 255 / np.iinfo(kind).max
    level, clipped = plain_samples.levels_of(pair.on)
    dark, clipped = (level, clipped) if pair.off is None else plain_samples.levels_of(pair.off)
    assert (sample.level, sample.clipped) == (scale * level, clipped)
    assert sample.change == pytest.approx(scale * abs(level - dark) / max(scale * dark, 32.0), rel=1e-12)
