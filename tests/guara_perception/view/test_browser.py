"""Tests of the view in a real browser."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.drawing.style import HAZARD_COLOURS, rgb
from guara_perception.view.browser import BrowserView, legend_html, status_text
from guara_perception.view.moment import Moment
from kinematics import RobotModel
from tests.guara_perception.view.chromium import Chromium, find_chromium

# Asked, not imported: each worker collects this file, whichever tests it runs.
needs_viser = pytest.mark.skipif(find_spec("viser") is None, reason="viser is not installed (extra `view`)")
pytestmark = [pytest.mark.view, pytest.mark.heavy, needs_viser]

CHROMIUM = find_chromium()
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine (Debian: chromium)")


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Chromium]:
    assert CHROMIUM is not None
    with Chromium(CHROMIUM, tmp_path / "profile") as chromium:
        yield chromium


def moment(grid: gp.TerrainGrid) -> Moment:
    stripe = np.column_stack((np.full(50, 0.9), np.linspace(-0.25, 0.25, 50), np.zeros(50)))
    return Moment({"footprint": grid}, stripes=lambda: [stripe], footholds={"rf": (0.5, -0.18, 0.0)})


def share(picture: np.ndarray, colour: tuple[float, float, float], tolerance: int) -> float:
    """Share of the pixels of (nearly) a colour, hue rather than brightness."""
    wanted = np.array(colour) * 255
    return float((np.abs(picture.astype(float) - wanted).max(axis=-1) < tolerance).mean())


@needs_chromium
def test_the_page_shows_robot_and_terrain(page: Chromium, robot: RobotModel, grid: gp.TerrainGrid) -> None:
    """Robot, ground and controls are there, nothing fails, and nothing is fetched from elsewhere."""
    with BrowserView(robot, port=18080) as view:
        view.show_recording([moment(grid), moment(grid)])
        page.call("Page.navigate", url=view.address)
        page.wait_for("document.querySelector('canvas') !== null")
        page.wait_for("document.body.innerText.includes('step 7')")
        assert page.evaluate("document.body.innerText.includes('a foot may be set here')")
        deadline = time.monotonic() + 60
        while True:
            picture = page.screenshot()[:, :650]
            ground = share(picture, rgb(HAZARD_COLOURS[gp.Hazard.EDGE]), 70)
            is_robot = (np.ptp(picture.astype(int), axis=-1) < 60) & (picture.max(axis=-1) < 190)
            if (ground > 0.01 and is_robot.mean() > 0.01) or time.monotonic() > deadline:
                break
            time.sleep(0.5)
        assert ground > 0.01
        assert is_robot.mean() > 0.01
        view.show(Moment({"footprint": gp.assess_terrain(np.full((4, 4), np.nan), 0.1)}))
        page.wait_for("document.body.innerText.includes('known 0%')")
        time.sleep(1.0)
        assert share(page.screenshot()[:, :650], rgb(HAZARD_COLOURS[gp.Hazard.EDGE]), 70) < ground / 4
        assert page.errors == []
        outside = [url for url in page.requests if not url.startswith((view.address, "data:", "blob:"))]
        assert outside == []


@needs_chromium
def test_the_command_serves_a_grid_until_it_is_stopped(page: Chromium, grid: gp.TerrainGrid, tmp_path: Path) -> None:
    """`guara view FILE` says where to look, shows the grid, and ends cleanly on Ctrl-C."""
    grid.save(tmp_path / "grid.npz")
    code = "import sys; from guara_perception.app.commands.view import command; command()"
    process = subprocess.Popen(
        [sys.executable, "-u", "-c", code, str(tmp_path / "grid.npz"), "--port", "18090"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )
    try:
        assert process.stdout is not None
        said = []
        for text in process.stdout:
            said.append(text)
            if "open http" in text:
                address = text.split("open ")[1].split(" ")[0]
                break
        else:
            pytest.fail(f"the command ended with {process.wait(10)}: {''.join(said)}")
        assert "1 scans of" in text
        page.call("Page.navigate", url=address)
        page.wait_for("document.body.innerText.includes('step 7')")
    finally:
        process.send_signal(signal.SIGINT)
    assert process.wait(30) == 0


@needs_chromium
def test_robot_check_shows_the_robot_and_what_it_would_see(page: Chromium, robot: RobotModel) -> None:
    """`guara robot check --view`: the robot, its area, and lines from camera and mirror; ends cleanly on Ctrl-C."""
    program = [sys.executable, "-u", "-m", "guara_perception.app.main", "robot", "check", "guara"]
    process = subprocess.Popen(
        [*program, "--view", "--port", "18110"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        assert process.stdout is not None
        said = []
        for text in process.stdout:
            said.append(text)
            if "open http" in text:
                address = text.split("open ")[1].split(" ")[0]
                break
        else:
            pytest.fail(f"the command ended with {process.wait(10)}: {''.join(said)}")
        assert "guara: sound, 1 notes" in "".join(said)
        page.call("Page.navigate", url=address)
        page.wait_for("document.body.innerText.includes('a foot may be set here')")
        deadline = time.monotonic() + 60
        while True:
            picture = page.screenshot()[:, :650]
            ground = share(picture, rgb(HAZARD_COLOURS[gp.Hazard.EDGE]), 70)
            lines = (picture[..., 0] > 180) & (picture[..., 1] < 130) & (picture[..., 2] < 100)
            if (ground > 0.005 and lines.mean() > 0.001) or time.monotonic() > deadline:
                break
            time.sleep(0.5)
        assert ground > 0.005 and lines.mean() > 0.001
        assert page.evaluate("document.body.innerText.includes('nominal scan')")
    finally:
        process.send_signal(signal.SIGINT)
    assert process.wait(30) == 0


def test_nothing_to_show_is_refused(robot: RobotModel) -> None:
    """A recording without grids is no recording to look at."""
    with BrowserView(robot, port=18100) as view, pytest.raises(InvalidInput, match="nothing to show"):
        view.show_recording([])


def test_texts_say_what_is_seen(grid: gp.TerrainGrid) -> None:
    """The status names step, mode and attitude; the legend says what each colour means."""
    text = status_text(grid)
    assert "**step 7**, standard scan, footprint" in text
    assert "attitude from imu" in text
    html = legend_html((("free", "#000000"), ("dropout", "#FF0000")))
    assert "a foot may be set here" in html
    assert "rgb(255,0,0)" in html
    assert "dark, absorbing or a hole" in html
