"""Each effect of real light is in the picture as strongly as stated."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.arrays import Float, Image
from guara_perception.simulation import EFFECTS, Light, SimulatedRangefinder, World, real_light, specimen
from guara_perception.simulation.features import Patch
from guara_perception.simulation.sensor import Blotches, scattered
from kinematics import load_robot

STRIPE = 25
# In these columns the ground is level soil, lit by the stripe.
LIT_COLUMNS = np.s_[100:540]


@lru_cache(maxsize=4)
def pictures(light: Light, index: int = STRIPE) -> tuple[Image, Image]:
    """Laser on and off over soil."""
    robot = load_robot("guara")
    rangefinder = SimulatedRangefinder(World(seed=2), specimen(robot, seed=1), robot, light=light)
    transform = np.eye(4)
    transform[2, 3] = 0.36
    rangefinder.set_pose(transform)
    return next(iter(rangefinder.frames([index])))[1:]


def about_the_stripe(light: Light, channel: int = 2, rows: int = 60) -> Float:
    """Mean light (2 rows + 1,) of the columns about the stripe's centre."""
    on, off = pictures(light)
    added = on[:, :, channel].astype(float) - off[:, :, channel]
    centre = np.array(cv2.GaussianBlur(on[:, :, 2].astype(np.float32) - off[:, :, 2], (9, 9), 2).argmax(axis=0))
    columns = np.arange(100, 540)
    around = centre[columns] + np.arange(-rows, rows + 1)[:, None]
    return np.asarray(added[around, columns].mean(axis=1))


@pytest.mark.slow
def test_the_stripe_is_as_wide_as_in_photographs() -> None:
    """Half the peak is reached over 12 px and not, as in plain light, over two."""
    for strength, least, most in ((0.0, 1, 3), (1.0, 10, 14)):
        light = about_the_stripe(real_light({"width": strength}))
        assert least <= (light > 0.5 * light.max()).sum() <= most


@pytest.mark.heavy
@pytest.mark.slow
def test_skirt_and_halo_lie_beside_the_stripe() -> None:
    """12, 6 and 3 % of the peak at 8, 15 and 30 px; 150 grey levels beside a clipped core, gone after 20 px."""
    column = np.zeros((121, 21), np.float32)
    column[60] = 200
    skirt = scattered(column, Light(skirt=0.12), 121)[:, 10] / 200
    np.testing.assert_allclose(skirt[[68, 75, 90]], [0.12, 0.064, 0.032], atol=0.004)
    column[60] = 300
    halo = scattered(column, Light(halo=150.0), 121)[:, 10]
    assert halo[61] == pytest.approx(150, rel=0.05)
    assert halo[60 + 22] < 0.1 * halo[61]
    assert scattered(np.minimum(column, 250), Light(halo=150.0), 121).max() == 250
    rendered = about_the_stripe(real_light({"skirt": 1.0}))
    assert 0.08 < rendered[60 + 8] / rendered[60] < 0.2


@pytest.mark.slow
def test_cores_clip_and_leak_as_in_photographs() -> None:
    """Clipped over 2 px and more in nearly all columns; a quarter of the light in blue, half in green."""
    on, _ = pictures(real_light({"clipping": 1.0}))
    clipped = (on[:, LIT_COLUMNS, 2] == 255).sum(axis=0)
    assert (clipped >= 2).mean() > 0.9 and np.median(clipped) <= 6
    leaking = real_light({"leakage": 1.0})
    red, green, blue = (about_the_stripe(leaking, channel)[57:64].sum() for channel in (2, 1, 0))
    assert green / red == pytest.approx(0.52, abs=0.05)
    assert blue / red == pytest.approx(0.25, abs=0.04)


@pytest.mark.heavy
@pytest.mark.slow
def test_ambient_light_clips_and_the_line_is_weak() -> None:
    """The brighter half of soil at the end of the scale; a line of 33 grey levels."""
    _, off = pictures(real_light({"ambient": 1.0}))
    assert 0.1 < (off[:, :, 2] == 255).mean() < 0.9
    assert 25 < about_the_stripe(real_light({"weak_line": 1.0})).max() < 45


@pytest.mark.heavy
@pytest.mark.slow
def test_noise_has_its_size_and_its_patches() -> None:
    """Seven grey levels from pixel to pixel, five in patches that neighbours share."""
    light = real_light({"noise": 1.0})
    rng = np.random.default_rng(0)
    whole = Blotches(rng.standard_normal((400, 400, 3)).astype(np.float32), light.blotches)
    patches = whole.draw(rng)
    assert patches.shape == (200, 200, 3) and (whole.draw(rng) != patches).any()
    assert patches.std() == pytest.approx(5.0, rel=0.1)
    assert np.corrcoef(patches[:, :-2, 0].ravel(), patches[:, 2:, 0].ravel())[0, 1] > 0.8
    assert abs(np.corrcoef(patches[..., 0].ravel(), patches[..., 1].ravel())[0, 1]) < 0.2
    first, second = pictures(light), pictures(Light())
    noise = first[1].astype(float) - second[1]
    assert noise[:, :, 2].std() == pytest.approx(np.hypot(7, 5), rel=0.15)


@pytest.mark.heavy
@pytest.mark.slow
def test_colour_filter_and_compression_take_colour_away() -> None:
    """A thin red line loses some of its red, most where colour is halved; the rest of the picture stays."""
    plain_on, plain_off = pictures(Light())
    redness = {}
    for name in ("demosaicing", "jpeg"):
        on, off = pictures(real_light({name: 1.0}))
        assert np.abs(off.astype(float) - plain_off).mean() < 2
        redness[name] = (on[:, LIT_COLUMNS, 2].astype(float) - on[:, LIT_COLUMNS, 1]).max(axis=0).mean()
    plain = (plain_on[:, LIT_COLUMNS, 2].astype(float) - plain_on[:, LIT_COLUMNS, 1]).max(axis=0).mean()
    assert redness["demosaicing"] < 0.98 * plain
    assert redness["jpeg"] < 0.9 * plain


@pytest.mark.heavy
@pytest.mark.slow
def test_exposure_drifts_and_lamps_flicker() -> None:
    """Each channel by its own factor between off and on; flicker brightens all channels alike, picture by picture."""
    on, off = pictures(real_light({"drift": 1.0}))
    ratio = on[400:].mean(axis=(0, 1)) / off[400:].mean(axis=(0, 1))
    np.testing.assert_allclose(ratio, [0.67, 1.4, 2.6], rtol=0.03)
    robot = load_robot("guara")
    rangefinder = SimulatedRangefinder(World(), specimen(robot, seed=1), robot, light=real_light({"flicker": 1.0}))
    transform = np.eye(4)
    transform[2, 3] = 0.36
    rangefinder.set_pose(transform)
    levels = np.array([on[400:].mean(axis=(0, 1)) for _, on, _ in rangefinder.frames(range(20))])
    relative = levels / levels.mean(axis=0)
    assert 0.05 < relative[:, 1].std() < 0.16
    np.testing.assert_allclose(relative[:, 0], relative[:, 2], rtol=0.03)


@pytest.mark.heavy
@pytest.mark.slow
def test_a_chessboard_covers_all_but_dark_ground() -> None:
    """White squares are ten times as bright as black ones; what swallows light still does."""
    robot = load_robot("guara")
    world = World(features=(Patch(x=0.7, y=0.1, size=(0.1, 0.1), material="dark"),))
    rangefinder = SimulatedRangefinder(world, specimen(robot, seed=1), robot, light=real_light({"chessboard": 1.0}))
    transform = np.eye(4)
    transform[2, 3] = 0.36
    view = rangefinder.set_pose(transform)
    points = view.points + view.origin
    is_dark = (np.abs(points[..., 0] - 0.7) < 0.045) & (np.abs(points[..., 1] - 0.1) < 0.045)
    elsewhere = view.reflectance[~is_dark & (np.abs(points[..., 0] - 0.7) < 0.2) & (np.abs(points[..., 1]) < 0.2)]
    bright, dim = np.percentile(elsewhere, [90, 10])
    assert bright / dim > 8
    assert view.reflectance[is_dark].max() < 0.02


@pytest.mark.heavy
@pytest.mark.slow
def test_a_ghost_is_a_second_weaker_stripe() -> None:
    """Below the stripe at the centre of the picture, 0.1 to 0.6 as bright, and nowhere else."""
    on, off = pictures(real_light({"ghosts": 1.0}))
    added = on[:, :, 2].astype(float) - off[:, :, 2]
    top = added.argmax(axis=0)
    below = np.array([added[top[c] + 12 : top[c] + 45, c].max() / added[top[c], c] for c in range(100, 540)])
    with_ghost, without = below[130:300], below[:60]
    assert 0.1 < np.median(with_ghost) < 0.6
    assert np.median(without) < 0.05


def test_every_effect_is_nothing_at_strength_zero_and_all_go_together() -> None:
    """Strength 0 is plain light; brighter and weaker laser multiply; unknown names and strengths are refused."""
    assert all(real_light({name: 0.0}) == Light() for name in EFFECTS)
    assert all(real_light({name: 1.0}) != Light() for name in EFFECTS)
    both = real_light({"clipping": 1.0, "weak_line": 1.0})
    assert both.laser == pytest.approx(620 * 8 * 0.4)
    assert not real_light(dict.fromkeys(EFFECTS, 0.5)).is_even
    with pytest.raises(gp.InvalidInput, match="effect is 'fog', allowed: width, skirt, halo"):
        real_light({"fog": 0.5})
    with pytest.raises(gp.InvalidInput, match=r"strength of ambient is 1\.5, allowed: 0 \.\.\. 1"):
        real_light({"ambient": 1.5})


def test_light_that_cannot_be_is_refused() -> None:
    """Shares above one, a picture without light, a quality that JPEG does not have."""
    for options, expected_text in (
        ({"skirt": 1.5}, r"skirt is 1\.5, allowed: 0 \.\.\. 1"),
        ({"chessboard": 2.0}, "chessboard is 2.0"),
        ({"ghost": 1.1}, "ghost is 1.1"),
        ({"jpeg_quality": 101}, r"jpeg_quality is 101, allowed: 0 \.\.\. 100"),
        ({"drift": (1.0, 0.0, 1.0)}, "drift is .*, allowed: values above 0"),
        ({"flicker": -0.1}, "flicker is -0.1, allowed: finite values of 0 or more"),
    ):
        with pytest.raises(gp.InvalidInput, match=expected_text):
            Light(**options)  # type: ignore[arg-type]
