"""Figures of a scan: complete, of the right size and orientation; range images survive a round trip through files."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stdout
from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.figures import figures
from guara_perception.app.figures.figures import (
    as_grey,
    corrected_image,
    draw_figures,
    median_stripe_frame,
    stripes_together,
)
from guara_perception.app.files.range_files import OFFSET_MM, SCALE_MM, to_8_bit, to_16_bit
from guara_perception.app.main import run
from guara_perception.scanning.pictures import cause_image, with_pictures
from guara_perception.scanning.process import run_scan
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK

pytestmark = pytest.mark.slow

NAMES = [
    "fig13_original_frame.png",
    "fig14_corrected_frame.png",
    "fig15_laser_stripes.png",
    "fig16_perspective_range_image.png",
    "fig17_orthorectified_range_image.png",
    "fig18_surface.png",
    "hazards.png",
    "range_image_16bit.png",
    "range_image_8bit.png",
    "ortho_image_16bit.png",
    "ortho_image_8bit.png",
    "ortho_image_causes.png",
    "range_images.json",
]


@pytest.fixture(scope="module")
def processor(paper_scan, calibration, robot) -> gp.ScanProcessor:
    return run_scan(paper_scan, calibration, robot)


@pytest.fixture(scope="module")
def drawn(data: Path, calibration_file: Path, tmp_path_factory) -> Path:
    """Figures drawn by `guara process`, which creates the folder and prints their number."""
    made = tmp_path_factory.mktemp("figures")
    folder, scan, said = made / "new" / "pictures", data / "scans" / "paper", io.StringIO()
    with redirect_stdout(said):
        code = run(
            ["process", str(scan), "-c", str(calibration_file), "-o", str(made / "t.npz"), "--figures", str(folder)]
        )
    assert code == 0 and said.getvalue().splitlines()[-1].startswith(f"{folder}: {len(NAMES)} ")
    return folder


@pytest.mark.heavy
def test_every_picture_is_there_and_shows_something(drawn: Path) -> None:
    """Exactly these files; each image is readable and has more than one colour."""
    assert sorted(path.name for path in drawn.iterdir()) == sorted(NAMES)
    for name in NAMES[:-1]:
        picture = cv2.imread(str(drawn / name), cv2.IMREAD_UNCHANGED)
        assert picture is not None and picture.size > 10_000 and picture.std() > 1, name


@pytest.mark.heavy
def test_16_bit_range_image_gives_the_heights_back(drawn: Path, paper_terrain: gp.TerrainGrid) -> None:
    """Scale and offset in the JSON recover the height to half a unit; unknown stays unknown."""
    meaning = json.loads((drawn / "range_images.json").read_text())["16bit"]
    values = cv2.imread(str(drawn / "ortho_image_16bit.png"), cv2.IMREAD_UNCHANGED)
    heights = np.where(values == meaning["unknown"], np.nan, values * meaning["scale_mm"] + meaning["offset_mm"])
    np.testing.assert_allclose(heights, paper_terrain.pictures["ortho_image_mm"], atol=0.0051)


def test_heights_to_whole_numbers_and_back() -> None:
    """16 bits: off by half a unit at most, clipped at the ends, NaN kept. 8 bits: lowest 1, highest 255, unknown 0."""
    image = np.array([[-50.0, 0.0, np.nan, 123.456, 9999.0]], np.float32)
    values = to_16_bit(image)
    back = np.where(values > 0, values * SCALE_MM + OFFSET_MM, np.nan)
    np.testing.assert_allclose(back[0, :4], [-50, 0, np.nan, 123.456], atol=0.0051)
    assert back[0, 4] == pytest.approx(65535 * 0.01 - 300, abs=0.01)
    shades, low, high = to_8_bit(image[:, :4])
    assert shades[0].tolist()[0] == 1 and shades[0, 2] == 0 and shades[0, 3] == 255
    assert (low, high) == (-50.0, pytest.approx(123.456))
    assert to_8_bit(np.full((2, 2), np.nan, np.float32))[0].max() == 0


def test_cause_image_is_that_of_the_cells(paper_terrain: gp.TerrainGrid) -> None:
    """An unknown pixel has the flags of its unknown cell, or UNSCANNED in a known cell; a known pixel has none."""
    causes = cause_image(paper_terrain)
    image = paper_terrain.pictures["ortho_image_mm"]
    assert causes.shape == image.shape
    np.testing.assert_array_equal(causes != 0, np.isnan(image))
    row, column = (int(i[0]) for i in np.nonzero(causes & ~np.uint8(gp.Hazard.UNSCANNED)))
    x, y = 0.50 + (row + 0.5) * 0.45 / 512, -0.27 + (column + 0.5) * 0.54 / 640
    assert causes[row, column] == int(paper_terrain.hazard_at(x, y)) & int(UNKNOWN_MASK)


def test_corrected_image_shows_the_stripe_where_it_was_measured(processor, paper_scan, calibration) -> None:
    """In the view from above, the brightest row of a stripe is at the x of its points on the floor."""
    settings = processor.settings
    stripe = sorted(paper_scan.stripes, key=lambda each: each.index)[10]
    on, off = paper_scan.read_frame(stripe.on), paper_scan.read_frame(stripe.off)
    light = as_grey(cv2.subtract(on, off))
    seen = corrected_image(
        light, calibration.camera, processor.transform_camera_to_footprint, (settings.footprint_x, settings.footprint_y)
    )
    assert seen.shape == (512, 640)
    points = processor.points[stripe.index].points
    points = points[np.isfinite(points[:, 2]) & (np.abs(points[:, 1]) < 0.2)]
    columns = ((points[:, 1] + 0.27) / 0.54 * 640).astype(int)
    rows = seen[:, columns].argmax(axis=0)
    x = 0.50 + (rows + 0.5) * 0.45 / 512
    assert np.median(np.abs(x - points[:, 0])) < 0.002


def test_stripes_together_leave_unreadable_frames_out(paper_scan: gp.Scan, paper_copy: Path) -> None:
    """An unreadable frame is skipped; without any readable frame, the image is refused."""
    whole = stripes_together(paper_scan)
    assert (whole >= median_stripe_frame(paper_scan)).all()
    stripes = gp.open_scan(paper_copy).stripes
    (paper_copy / stripes[3].on).write_bytes(b"broken")
    assert stripes_together(gp.open_scan(paper_copy)).shape == whole.shape
    for stripe in stripes:
        (paper_copy / stripe.on).write_bytes(b"broken")
    with pytest.raises(gp.FileFormatError, match="no laser-on frame can be read"):
        stripes_together(gp.open_scan(paper_copy))


def test_what_cannot_be_drawn_is_refused(processor, paper_scan, calibration, paper_terrain, tmp_path: Path) -> None:
    """A grid without range images is refused, and so is a file in place of the folder."""
    with pytest.raises(gp.InvalidInput, match="has no range images"):
        draw_figures(tmp_path, paper_scan, calibration, processor, processor.finish())
    taken = tmp_path / "taken"
    taken.write_text("")
    with pytest.raises(gp.InvalidInput, match="is a file; a folder is needed"):
        draw_figures(taken, paper_scan, calibration, processor, paper_terrain)


@pytest.mark.heavy
def test_scan_of_nothing_can_be_drawn(paper_scan, calibration, robot, tmp_path: Path, monkeypatch) -> None:
    """If all cells are unknown, every figure of the grid is still drawn."""
    monkeypatch.setattr(figures, "draw_image", lambda path, *_: path.write_bytes(b"frame") and path)
    empty = gp.ScanProcessor(calibration, robot, paper_scan.stance, paper_scan.mode)
    paths = draw_figures(tmp_path, paper_scan, calibration, empty, with_pictures(empty.finish(), empty))
    assert all(path.stat().st_size > 0 for path in paths)
