"""Style of figures."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest

from guara_perception.exceptions import MissingFile
from guara_perception.terrain.drawing import style
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard

# Machado, Oliveira, Fernandes 2009, severity 1.0, for linear RGB.
BLINDNESS = {
    "none": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
}


def lab(colour: str, blindness: str) -> np.ndarray:
    """CIE Lab of a colour as seen with a given colour blindness."""
    srgb = np.array(style.rgb(colour))
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.array(BLINDNESS[blindness]) @ linear, 0, 1)
    srgb = np.where(seen <= 0.0031308, 12.92 * seen, 1.055 * seen ** (1 / 2.4) - 0.055)
    return cv2.cvtColor(srgb.astype(np.float32)[None, None], cv2.COLOR_RGB2LAB)[0, 0]


@pytest.mark.parametrize("blindness", BLINDNESS)
def test_hazard_colours_differ(blindness: str) -> None:
    """Any two hazard colours are distinguishable with and without red-green blindness."""
    colours = {"free": style.FREE_COLOUR, **{str(f.name): c for f, c in style.HAZARD_COLOURS.items()}}
    distances = {
        (a, b): float(np.linalg.norm(lab(colours[a], blindness) - lab(colours[b], blindness)))
        for a, b in itertools.combinations(colours, 2)
    }
    closest = min(distances, key=distances.__getitem__)
    # 2.3 is the just noticeable difference; areas with a legend need several times that.
    assert distances[closest] > 9.0, (closest, distances[closest])


def test_every_flag_has_a_colour() -> None:
    """No hazard is drawn as free ground."""
    assert set(style.HAZARD_COLOURS) == {flag for flag in Hazard if flag}
    for flag in style.HAZARD_COLOURS:
        picture, shown = style.hazard_picture(np.array([[flag]], dtype=np.uint16))
        assert tuple(picture[0, 0]) == pytest.approx(style.rgb(style.HAZARD_COLOURS[flag]), abs=1e-6)
        assert shown == [(str(flag.name).lower().replace("_", " "), style.HAZARD_COLOURS[flag])]


def test_the_cause_comes_before_the_edge() -> None:
    """An unknown EDGE cell shows its cause; free cells come first in the legend."""
    hazard = np.array([[0, Hazard.EDGE | Hazard.DROPOUT]], dtype=np.uint16)
    picture, shown = style.hazard_picture(hazard)
    assert [name for name, _ in shown] == ["free", "dropout"]
    assert tuple(picture[0, 1]) == style.rgb(style.HAZARD_COLOURS[Hazard.DROPOUT])


def test_layers_are_drawn_x_up_and_y_left() -> None:
    """The cell at largest x and y is at the top left of the picture."""
    geometry = GridGeometry((0.0, 0.0), 1.0, (2, 3))
    values = np.zeros((2, 3))
    values[1, 2] = 1.0
    figure, axes = style.new_figure()
    style.draw_layer(axes[0, 0], geometry, values, cmap="gray", vmin=0, vmax=1)
    axes[0, 0].set_axis_off()
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[:, :, 0]
    # The axes are surrounded by white, and the picture is black except for one cell: find it by its black pixels.
    rows, columns = np.nonzero(pixels < 100)
    crop = pixels[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    height, width = crop.shape
    assert crop[height // 6, width // 4] > 200
    assert crop[height // 6, 3 * width // 4] < 100
    assert crop[5 * height // 6, width // 4] < 100


def test_figures_are_saved_whole(tmp_path) -> None:
    """A figure is saved as a readable picture that is not blank; a missing folder is rejected."""
    figure, axes = style.new_figure(size=(3.0, 2.0))
    style.draw_hazards(axes[0, 0], GridGeometry((0.0, 0.0), 0.1, (4, 4)), np.full((4, 4), 512, dtype=np.uint16))
    style.save_figure(figure, tmp_path / "map.png")
    picture = cv2.imread(str(tmp_path / "map.png"))
    assert picture.shape == (300, 450, 3)
    assert picture.std() > 5
    assert [path.name for path in tmp_path.iterdir()] == ["map.png"]
    with pytest.raises(MissingFile, match="does not exist"):
        style.save_figure(figure, tmp_path / "nowhere" / "map.png")


def test_the_style_holds_while_drawing_and_no_longer() -> None:
    """Titles drawn in the style have its size; afterwards matplotlib is unchanged."""
    import matplotlib

    before = matplotlib.rcParams["axes.titlesize"], matplotlib.rcParams["font.size"]
    with style.styled():
        _, axes = style.new_figure()
        title = axes[0, 0].set_title("Heights")
    assert title.get_fontsize() == 9.0
    assert (matplotlib.rcParams["axes.titlesize"], matplotlib.rcParams["font.size"]) == before
