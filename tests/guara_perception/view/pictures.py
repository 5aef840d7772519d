"""Makes the documents' pictures of the browser view, of the robot, and of the scene in Rerun.

`python -m tests.guara_perception.view.pictures out/demo/walk.mcap docs/images`

Chromium and Rerun's viewer draw them, in software.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

import guara_perception as gp
from guara_perception.app.scene.rerun_scene import save_rerun_scene
from guara_perception.app.view_moments import load_moments
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.record import ScanRecord
from guara_perception.view.browser import BrowserView
from guara_perception.view.moment import Moment
from kinematics import RobotModel, Stance, load_robot
from tests.guara_perception.view.chromium import Chromium, find_chromium

SIZE_PX = (1440, 900)
RERUN_PORT = 19876
JPEG_QUALITY = 88
# [s] Software draws slowly: for this long nothing may change.
STILL = 1.5
PATIENCE = 120.0


def still(page: Chromium) -> np.ndarray:
    """The page once it no longer changes."""
    deadline = time.monotonic() + PATIENCE
    before = page.screenshot()
    while True:
        time.sleep(STILL)
        now = page.screenshot()
        if np.array_equal(now, before):
            return now
        assert time.monotonic() < deadline, "the page never stood still"
        before = now


def open_view(page: Chromium, view: BrowserView) -> None:
    """Open a view without the notice that there is no graphics card."""
    page.call("Page.navigate", url=view.address)
    page.wait_for("document.querySelector('canvas') !== null && document.body.innerText.includes('step')")
    page.wait_for("document.querySelector('.mantine-Notification-closeButton') !== null")
    page.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach(b => b.click())")


def save(picture: np.ndarray, path: Path) -> None:
    """Write a picture and say so."""
    cv2.imwrite(str(path), picture[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))
    print(path)


def standing(robot: RobotModel) -> Moment:
    """The robot in its scan posture on a strip of level ground."""
    stance = Stance(robot.posture("scan"), robot.legs)
    pose = robot.stance_pose(stance, find_unloaded=False)
    grid = GridGeometry.over((-0.45, 0.95), (-0.35, 0.35), 0.01)
    floor = gp.assess_terrain(np.zeros(grid.shape), 0.01, origin=grid.origin)
    metadata = {
        **floor.metadata,
        "stance": stance.to_dict(),
        "transform_base_to_footprint": pose.transform_base_to_footprint.tolist(),
    }
    return Moment(
        {"footprint": type(floor)(layers=floor.layers, geometry=floor.geometry, record=ScanRecord.from_json(metadata))}
    )


def in_rerun(recording: Path) -> np.ndarray:
    """The scene of a recording as Rerun's viewer opens it, red, green, blue."""
    from rerun.experimental import ViewerClient

    with tempfile.TemporaryDirectory() as scratch:
        scene = save_rerun_scene(recording, Path(scratch) / "walk.rrd")
        options = ["--headless", "--window-size", "1600x900", "--bind", "127.0.0.1", "--port", str(RERUN_PORT)]
        viewer = subprocess.Popen([sys.executable, "-m", "rerun", scene, *options], stderr=subprocess.DEVNULL)
        try:
            deadline = time.monotonic() + PATIENCE
            before = np.zeros(0)
            while True:
                time.sleep(5 * STILL)
                assert time.monotonic() < deadline, "Rerun never stood still"
                try:
                    client = ViewerClient.connect(f"rerun+http://127.0.0.1:{RERUN_PORT}/proxy")
                    client.save_screenshot(str(scene.with_suffix(".png")))
                except Exception as error:  # it is not up yet
                    print(error)
                    continue
                now = cv2.imread(str(scene.with_suffix(".png")))
                if np.array_equal(now, before):
                    return now[..., ::-1]
                before = now
        finally:
            viewer.terminate()
            viewer.wait(30)


def main(recording: Path, folder: Path) -> None:
    """Make them all."""
    save(in_rerun(recording), folder / "rerun.jpg")
    robot = load_robot("guara")
    _, moments = load_moments(recording, robot)
    chromium = find_chromium()
    assert chromium is not None, "no Chromium on this machine"
    with tempfile.TemporaryDirectory() as scratch, Chromium(chromium, Path(scratch) / "profile") as page:
        width, height = SIZE_PX
        page.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        with BrowserView(robot, port=18400) as view:
            view.show_recording(moments)
            view._go_to(2 * len(moments) // 3)
            open_view(page, view)
            still(page)
            for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
                page.call("Input.dispatchMouseEvent", type=kind, x=590, y=455, button="left", clickCount=1)
            page.wait_for("document.body.innerText.includes('mm high')")
            save(still(page), folder / "view.jpg")
            # The page is left before its server ends, or it would show that the connection is lost.
            page.call("Page.navigate", url="about:blank")
        with BrowserView(robot, port=18410) as view:
            view.show_recording([standing(robot)])
            open_view(page, view)
            save(still(page)[200:710, 320:1080], folder / "robot.jpg")
        assert page.errors == [], page.errors


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
