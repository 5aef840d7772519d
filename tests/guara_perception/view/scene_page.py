"""Helpers for tests of the page of the view in a browser: what its pictures show, and how to operate it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from tests.guara_perception.view.chromium import Chromium

PATIENCE_S = 90.0


# Columns of the picture between the panels.
SCENE = np.s_[:, 320:660]


def share(picture: np.ndarray, colour: Any, tolerance: int) -> float:
    """Share of the pixels whose channels are all within `tolerance` of those of a colour [of 255]."""
    wanted = np.array(colour) * 255
    return float((np.abs(picture.astype(float) - wanted).max(axis=-1) < tolerance).mean())


def is_rust(picture: np.ndarray) -> np.ndarray:
    """Pixels of the Guará's body."""
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    return (red > 100) & (red > 1.7 * green) & (green > blue) & (red < 200) & (green < 95)


def is_laser(picture: np.ndarray) -> np.ndarray:
    """Pixels of stripes: red, with more blue than green, as nothing else in the scene."""
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    return (red > 150) & (red > green + 60) & (blue > green + 10)


def until(page: Chromium, condition: Callable[[np.ndarray], bool], what: str) -> np.ndarray:
    """The first picture of the page that meets a condition; drawing in software is slow."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        picture = page.screenshot()
        if condition(picture):
            return picture
        assert time.monotonic() < deadline, f"never seen: {what}; page errors: {page.errors}"
        time.sleep(0.3)


def open_page(page: Chromium, address: str, text: str) -> None:
    """Open the view, wait for a text of the panel, and close the notice that there is no graphics card."""
    page.call("Page.navigate", url=address)
    page.wait_for("document.querySelector('canvas') !== null")
    page.wait_for(f"document.body.innerText.includes('{text}')")
    page.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach(b => b.click())")


def press(page: Chromium, label: str) -> None:
    """Click the button with a label."""
    find = f"[...document.querySelectorAll('button')].find(b => b.innerText.trim() === '{label}')"
    page.wait_for(f"{find} !== undefined && !{find}.disabled")
    page.evaluate(f"{find}.click()")


def tick(page: Chromium, label: str) -> None:
    """Click the check box beside a label."""
    page.evaluate(
        f"[...document.querySelectorAll('label')].find(l => l.innerText.trim() === '{label}')"
        ".closest('div').parentElement.parentElement.querySelector('input[type=checkbox]').click()"
    )


def click(page: Chromium, x: int, y: int) -> None:
    """Press and release the left button at a pixel."""
    for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
        page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
