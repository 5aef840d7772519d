"""Text, HTML and plots of grids; unknown cells are never drawn as heights."""

from __future__ import annotations

import base64
import re

import cv2
import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_hex

import guara_perception as gp
from guara_perception.terrain.drawing.style import UNKNOWN_COLOUR, new_figure
from guara_perception.terrain.layers.layers import LAYER_NAMES
from tests.thorough import further


@pytest.fixture
def terrain(make_scan) -> gp.TerrainGrid:
    """Floor with a box of 60 mm and an unobserved strip."""
    heights = np.zeros((108, 90))
    heights[40:60, 30:50] = 0.06
    flags = np.zeros((108, 90), np.uint16)
    flags[:, 80:] = gp.Hazard.DROPOUT
    return make_scan(heights, flags=flags, step=7)


def test_repr_says_what_the_grid_holds_in_three_lines(terrain):
    """Extent, cells, area, fractions, heights and the most frequent hazards; no arrays."""
    lines = repr(terrain).splitlines()
    assert len(lines) == 3
    assert lines[0] == (
        "TerrainGrid: footprint of step 7, 90 x 108 cells of 5 mm, "
        "x 0.50 ... 0.95 m, y -0.27 ... 0.27 m in base_footprint"
    )
    assert lines[1].startswith("  known 88.9%, traversable ") and lines[1].endswith("heights 0.0 ... 60.0 mm")
    assert lines[2].startswith("  hazards: EDGE ") and "DROPOUT 1080" in lines[2]


def test_repr_of_a_grid_that_knows_nothing(make_scan):
    """Without known cells, no heights are shown."""
    text = repr(make_scan(0.0, flags=int(gp.Hazard.UNSCANNED)))
    assert "known 0.0%, traversable 0.0%" in text and "heights" not in text and "UNSCANNED 9720" in text


@pytest.mark.slow
def test_html_holds_the_text_and_a_picture(terrain):
    """A notebook shows the three lines and one valid PNG that is not blank."""
    page = terrain._repr_html_()
    assert "TerrainGrid: footprint of step 7" in page
    data = base64.b64decode(re.search(r"base64,([^\"]+)\"", page)[1])
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape[1] > 500 and picture.std() > 10


@pytest.mark.slow
@pytest.mark.parametrize(
    "layer", ["elevation", "hazard", *further(*(n for n in LAYER_NAMES if n not in ("elevation", "hazard")))]
)
def test_every_layer_can_be_plotted(terrain, layer):
    """Each layer is drawn with x up and y to the left, with its name."""
    figure, axes = new_figure()
    drawn = terrain.plot(layer, axes=axes[0, 0])
    assert drawn is axes[0, 0]
    assert drawn.get_xlim() == pytest.approx((0.27, -0.27)) and drawn.get_ylim() == pytest.approx((0.50, 0.95))
    assert drawn.get_title() == f"{layer.replace('_', ' ')}, footprint, step 7"
    grey = "pale grey: no bound" if layer == "ceiling" else "pale grey: unknown"
    assert [text.get_text().split(",")[0] for text in drawn.texts] == ([] if layer == "hazard" else [grey])
    figure.canvas.draw()


def test_unknown_cells_are_drawn_in_the_colour_of_the_unknown(terrain):
    """The unobserved far strip has the pale grey of the axes' background, not a colour of a height."""
    figure, axes = new_figure(size=(4, 4))
    drawn = terrain.plot(axes=axes[0, 0], hazards=False)
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())
    column, row = drawn.transData.transform((0.0, 0.93)).round().astype(int)
    assert to_hex(pixels[pixels.shape[0] - row, column] / 255).upper() == UNKNOWN_COLOUR
    column, row = drawn.transData.transform((0.0, 0.70)).round().astype(int)
    assert to_hex(pixels[pixels.shape[0] - row, column] / 255).upper() != UNKNOWN_COLOUR


def test_footholds_are_marked_where_they_are(terrain):
    """Objects with x and y, and pairs, are marked with y across and x up."""
    figure, axes = new_figure()
    drawn = terrain.plot(
        axes=axes[0, 0], footholds=[(0.6, 0.1), gp.Foothold(0.7, -0.1, 0.0, np.array([0.0, 0.0, 1.0]), 0.9, 0.9, None)]
    )
    assert drawn.collections[-1].get_offsets().tolist() == [[0.1, 0.6], [-0.1, 0.7]]


def test_without_axes_a_figure_of_pyplot_is_made(terrain):
    """`plt.show()` finds the figure."""
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    axes = terrain.plot("slope")
    assert axes.figure.number in plt.get_fignums()
    plt.close(axes.figure)


def test_wrong_layer_and_foothold_are_refused(terrain):
    """The message lists the layers, or describes a foothold."""
    with pytest.raises(gp.InvalidInput, match="layer is 'height', allowed: elevation, variance"):
        terrain.plot("height")
    with pytest.raises(gp.InvalidInput, match=r"a foothold is 3; it must have x and y, or be a pair \(x, y\) \[m\]"):
        terrain.plot(footholds=[3])


def test_completion_offers_the_layers(terrain):
    """`dir` lists layers and queries."""
    assert {"elevation", "hazard", "plot", "best_foothold"} <= set(dir(terrain))


def test_what_cannot_be_drawn_is_refused(terrain):
    """An array instead of the name of a layer, and a None of `best_foothold`."""
    with pytest.raises(gp.InvalidInput, match=r"layer is a ndarray, allowed: elevation.*on the axes that plot returns"):
        terrain.plot(terrain.hazard == 0)
    with pytest.raises(gp.InvalidInput, match="a foothold is None.*best_foothold found none: skip None"):
        terrain.plot(footholds=[None])


def test_regions_are_outlined_where_they_are(terrain):
    """All corners are on a closed line, x up and y to the left; other objects are rejected."""
    regions = terrain.steppable_regions()
    assert regions
    axes = terrain.plot(regions=regions, axes=new_figure(1, 1, (4, 3))[1][0, 0])
    lines = [np.asarray(line.get_xydata()) for line in axes.lines]
    for region in regions:
        corners = region.vertices[:, 1::-1]
        fits = [line for line in lines if len(line) == len(corners) + 1 and np.allclose(line[:-1], corners)]
        assert len(fits) == 2 and all((line[0] == line[-1]).all() for line in fits)
    for wrong in ((0.7, 0.1), None, np.zeros((2, 2))):
        with pytest.raises(gp.InvalidInput, match="a region is a "):
            terrain.plot(regions=[wrong], axes=axes)
