"""Tests of the view in a real browser."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.drawing.style import HAZARD_COLOURS, rgb
from guara_perception.terrain.layers.record import MapRecord
from guara_perception.view import browser
from guara_perception.view.browser import BrowserView
from guara_perception.view.moment import Moment
from guara_perception.view.scene_drawing import REGION_COLOUR, TRAIL_COLOUR
from kinematics import RobotModel
from tests.guara_perception.view.chromium import Chromium, find_chromium
from tests.guara_perception.view.scene_page import SCENE, click, is_laser, is_rust, open_page, press, share, tick, until

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


TERRAIN = rgb(HAZARD_COLOURS[gp.Hazard.EDGE])
TRAIL = np.array(TRAIL_COLOUR) / 255
# The camera's picture, red, green, blue: a colour that nothing else on the page has.
PICTURE = (20, 200, 220)


def moment(grid: gp.TerrainGrid, step: int = 7, x: float = 0.0) -> Moment:
    """A pause at x in odom, with a stripe, a foothold and a picture."""
    stripe = np.column_stack((np.full(900, 0.9), np.linspace(-0.25, 0.25, 900), np.zeros(900)))
    transform = np.eye(4)
    transform[0, 3] = x
    metadata = {**grid.metadata, "epoch": "walk", "transform_footprint_to_odom": transform.tolist()}
    picture = np.full((120, 160, 3), PICTURE[::-1], np.uint8)
    known = dataclasses.replace(grid, step=step, extent="map", record=MapRecord.from_json(metadata))
    return Moment(
        {"footprint": dataclasses.replace(grid, step=step), "map": known},
        stripes=lambda: [stripe],
        footholds={"rf": (0.5, -0.18, 0.0)},
        picture=lambda: picture,
    )


@needs_chromium
def test_the_page_shows_robot_and_terrain(page: Chromium, robot: RobotModel, grid: gp.TerrainGrid) -> None:
    """Robot, ground, stripe, camera and legend are there, nothing fails, and nothing is fetched from elsewhere."""
    with BrowserView(robot, port=18080) as view:
        view.show_recording([moment(grid), moment(grid, 8)])
        open_page(page, view.address, "step 7")
        for expected_text in (
            "a foot may be placed here",
            "Known, not traversable",
            "not drawn: unknown because never observed",
        ):
            assert page.evaluate(f"document.body.innerText.includes('{expected_text}')"), expected_text

        def is_whole(picture: np.ndarray) -> bool:
            scene = picture[SCENE]
            return (
                share(scene, TERRAIN, 70) > 0.005
                and is_rust(scene).mean() > 0.003
                and is_laser(scene).mean() > 0.0001
                and share(picture, np.array(PICTURE) / 255, 12) > 0.01
            )

        whole = until(page, is_whole, "robot, ground, stripe and picture")
        tick(page, "stripes")
        until(page, lambda picture: not is_laser(picture[SCENE]).any(), "the stripe gone")
        view.show_recording([Moment({"footprint": gp.assess_terrain(np.full((4, 4), np.nan), 0.1)})])
        page.wait_for("document.body.innerText.includes('known 0%')")
        ground = share(whole[SCENE], TERRAIN, 70)
        until(page, lambda picture: share(picture[SCENE], TERRAIN, 70) < ground / 4, "no ground")
        until(page, lambda picture: is_rust(picture[SCENE]).mean() < 1e-4, "no robot where joints are unknown")
        assert page.evaluate("document.body.innerText.includes('no camera image available')")
        assert page.errors == []
        outside = [url for url in page.requests if not url.startswith((view.address, "data:", "blob:"))]
        assert outside == []


@needs_chromium
def test_steppable_regions_are_outlined_when_their_box_is_ticked(
    page: Chromium, robot: RobotModel, grid: gp.TerrainGrid
) -> None:
    """Not at first; the legend names them; their lines are on the ground while the box is ticked."""

    def lines(picture: np.ndarray) -> float:
        return share(picture[SCENE], np.array(REGION_COLOUR) / 255, 24)

    with BrowserView(robot, port=18087) as view:
        view.show_recording([moment(grid)])
        open_page(page, view.address, "step 7")
        assert page.evaluate("document.body.innerText.includes('the sole centre may be placed anywhere inside')")
        before = lines(until(page, lambda picture: share(picture[SCENE], TERRAIN, 70) > 0.005, "the ground"))
        tick(page, "regions")
        until(page, lambda picture: lines(picture) > before + 0.0005, "outlines of regions")
        tick(page, "regions")
        until(page, lambda picture: lines(picture) <= before + 0.0001, "the outlines gone")
        assert page.errors == []


@needs_chromium
def test_a_walk_is_played_and_leaves_a_trail(
    page: Chromium, robot: RobotModel, grid: gp.TerrainGrid, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The button plays to the end; the robot moves over the ground, its trail behind it; the viewpoint can stay."""
    with BrowserView(robot, port=18120) as view:
        view.show_recording([moment(grid, step, 0.2 * step) for step in range(4)])
        open_page(page, view.address, "step 0")
        tick(page, "follow robot")
        first = until(page, lambda picture: is_rust(picture[SCENE]).mean() > 0.003, "the robot")
        assert share(first[SCENE], TRAIL, 40) == 0.0
        press(page, "play")
        page.wait_for("document.body.innerText.includes('step 3')")
        last = until(page, lambda picture: share(picture[SCENE], TRAIL, 40) > 0.0001, "the trail")

        def centre(picture: np.ndarray) -> float:
            return float(np.nonzero(is_rust(picture[SCENE]))[1].mean())

        # Forwards is to the right in the picture.
        assert centre(last) > centre(first) + 20
        # From the end it begins again, and stops when asked to.
        monkeypatch.setattr(browser, "PLAY_PERIOD_S", 3600.0)
        press(page, "play")
        page.wait_for("document.body.innerText.includes('step 0')")
        press(page, "stop")
        page.wait_for("[...document.querySelectorAll('button')].some(b => b.innerText.trim() === 'play')")
        assert page.errors == []


@needs_chromium
def test_a_click_explains_the_cell_and_a_scale_has_its_bar(
    page: Chromium, robot: RobotModel, grid: gp.TerrainGrid
) -> None:
    """Where the ground is seen a click says what is known of it; other colours come with a bar of them."""
    with BrowserView(robot, port=18140) as view:
        view.show_recording([moment(grid)])
        open_page(page, view.address, "Click a cell")

        def edge(picture: np.ndarray) -> np.ndarray:
            """Pixels (n, 2), row and column of the scene, that lie within a yellow piece of ground."""
            scene = picture[SCENE].astype(int)
            is_yellow = (scene[..., 0] > scene[..., 2] + 30) & (scene[..., 1] > scene[..., 2] + 30)
            return np.argwhere(cv2.erode(is_yellow.astype(np.uint8), np.ones((5, 5), np.uint8)))

        found = edge(until(page, lambda picture: len(edge(picture)) > 50, "the edge of the ground"))
        y, x = found[len(found) // 2]
        click(page, int(x) + 320, int(y))
        page.wait_for("document.body.innerText.includes('traversable') && document.body.innerText.includes('mm high')")
        assert page.evaluate("/x=-?[0-9.]+ y=-?[0-9.]+/.test(document.body.innerText)")
        view._controls.colouring.value = "elevation"
        page.wait_for("document.body.innerText.includes('+60 mm')")
        assert page.evaluate("document.body.innerHTML.includes('linear-gradient(to right')")
        bar = "[...document.querySelectorAll('div')].find(d => d.style.background.startsWith('linear-gradient'))"
        box = page.evaluate(f"JSON.stringify({bar}.getBoundingClientRect())")
        where = json.loads(box)
        row = page.screenshot()[int(where["y"] + where["height"] / 2), int(where["x"]) + 2 : int(where["right"]) - 2]
        # From the dark blue of low ground to the yellow of high.
        assert row[0, 2] > row[0, 0] + 30 and row[-1, 0] > row[-1, 2] + 100
        assert page.errors == []


@needs_chromium
def test_a_live_walk_shows_stripes_camera_and_what_was_before(
    page: Chromium, robot: RobotModel, grid: gp.TerrainGrid
) -> None:
    """A new pause is shown if the newest was; after going back the view stays, and the slider reaches the new ones."""
    with BrowserView(robot, port=18160) as view:
        open_page(page, view.address, "waiting for a scan")
        view.add(Moment({"footprint": moment(grid, 1).any_grid}))
        page.wait_for("document.body.innerText.includes('step 1')")
        boxes = "[...document.querySelectorAll('input[type=checkbox]')]"
        page.wait_for(f"{boxes}.filter(box => box.disabled).length === 1")
        view.add(moment(grid, 1))
        page.wait_for(f"{boxes}.every(box => !box.disabled)")
        until(page, lambda picture: is_laser(picture[SCENE]).mean() > 0.0001, "the stripe")
        view.add(moment(grid, 2, 0.2))
        page.wait_for("document.body.innerText.includes('step 2')")
        view._go_to(0)
        page.wait_for("document.body.innerText.includes('step 1')")
        view.add(moment(grid, 3, 0.4))
        slider = "document.querySelector('[role=slider]')"
        page.wait_for(f"{slider}.getAttribute('aria-valuemax') === '2'")
        assert page.evaluate("document.body.innerText.includes('step 1')")
        view._go_to(2)
        page.wait_for("document.body.innerText.includes('step 3')")
        assert page.errors == []


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
        assert "(pauses: 1;" in text
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
        assert "guara: sound, 1 note\n" in "".join(said)
        page.call("Page.navigate", url=address)
        page.wait_for("document.body.innerText.includes('a foot may be placed here')")
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
