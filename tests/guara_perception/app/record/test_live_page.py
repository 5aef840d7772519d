"""Live page, over HTTP and in a real browser."""

from __future__ import annotations

import json
import urllib.error
import urllib.request

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.record.live_page import LivePage
from guara_perception.app.record.operator import TextOperator
from guara_perception.calibration.board import BoardSpec
from guara_perception.settings import Settings
from kinematics import RobotModel
from tests.guara_perception.view.chromium import Chromium, find_chromium


def get(address: str) -> bytes:
    """Response of the page."""
    with urllib.request.urlopen(address, timeout=10) as answer:
        return answer.read()


@pytest.mark.slow
def test_page_shows_task_advice_and_picture():
    """State and image are the latest; before the first image there is none."""
    with LivePage() as page:
        assert b"<img" in get(page.address)
        with pytest.raises(urllib.error.HTTPError, match="404"):
            get(page.address + "picture.jpg")
        page.show_task("the crosses")
        page.ask("lay them")
        page.watch(np.full((1000, 2000), 40_000, np.uint16), "move it left")
        assert json.loads(get(page.address + "state.json")) == {
            "task": "the crosses",
            "request": "lay them",
            "advice": "move it left",
            "number": 1,
        }
        picture = cv2.imdecode(np.frombuffer(get(page.address + "picture.jpg"), np.uint8), cv2.IMREAD_COLOR)
        assert picture.shape == (480, 960, 3) and abs(float(picture.mean()) - 40_000 / 256) < 2
    with pytest.raises(urllib.error.URLError):
        get(page.address)


@pytest.mark.slow
def test_a_taken_port_is_refused():
    """The message asks for another port."""
    with LivePage() as page:
        port = int(page.address.split(":")[2].strip("/"))
        with pytest.raises(gp.InvalidInput, match=f"port {port}: .*; give another --port"):
            LivePage(port)


def test_person_is_asked_task_by_task(
    robot: RobotModel, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Each request waits for a key, except for the held board, whose advice is printed once."""
    waited: list[str] = []
    reported: list[str] = []
    monkeypatch.setattr("click.pause", waited.append)
    operator = TextOperator(reported.append, Settings.of(robot))
    operator.clear()
    for _ in range(3):
        operator.show_board("tilt it")
    operator.lay_board(BoardSpec(9, 7, 0.03), "the board is blurred")
    operator.lay_crosses("(1, 2)", "cross 3 not found")
    operator.lay_plate(0.04)
    operator.lay_plate(0.0)
    assert waited == ["then press any key "] * 5 and reported.count("tilt it") == 1
    assert reported[2].startswith("the board is blurred. Lay the board") and "cross 3 not found" in reported[3]
    assert "plate of 40 mm" in reported[4] and "Clear the floor" in reported[5]
    assert capsys.readouterr().err.splitlines() == reported


@pytest.mark.slow
@pytest.mark.view
def test_page_in_a_browser_shows_what_is_reported(tmp_path):
    """Chromium shows the advice and draws the image; the page contacts no other machine."""
    chromium = pytest.importorskip("websockets", reason="extra view") and find_chromium()
    if chromium is None:
        pytest.skip("no Chromium on this machine")
    with LivePage() as page, Chromium(chromium, tmp_path / "profile") as browser:
        page.show_task("the board on the floor")
        page.ask("press any key")
        page.watch(np.full((300, 400, 3), (0, 0, 255), np.uint8), "lay it flat")
        browser.call("Page.navigate", url=page.address)
        browser.wait_for(
            "document.getElementById('advice') && document.getElementById('advice').textContent == 'lay it flat'"
        )
        browser.wait_for("document.getElementById('picture').naturalWidth == 400")
        assert browser.evaluate("document.getElementById('request').textContent") == "press any key"
        assert browser.evaluate("document.getElementById('task').textContent") == "the board on the floor"
        red = (browser.screenshot().astype(int) @ np.array([[1], [-1], [-1]]) > 150).mean()
        assert red > 0.1 and browser.errors == []
        assert all(address.startswith(page.address) or address == "about:blank" for address in browser.requests)
