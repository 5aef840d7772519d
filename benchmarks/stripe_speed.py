"""Times stripe extraction against a plain cv2 and numpy reference on the same frames: ratios, not milliseconds."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.synthetic_stripes import CASES, stripes
from guara_perception.stripes.extract import METHODS

Frame = npt.NDArray[np.uint8]
Contender = Callable[[Frame, Frame], Any]

ROUNDS = 9
FRAMES = 35
REFERENCE = "reference: cv2 + numpy"


def band_floor(on: Frame, off: Frame) -> int:
    """Touch every byte of the band once."""
    words = on.view(np.uint8).ravel()
    other = off.view(np.uint8).ravel()
    n = words.size // 8 * 8
    return int(np.bitwise_xor.reduce(words[:n].view(np.uint64)) ^ np.bitwise_xor.reduce(other[:n].view(np.uint64)))


class Reference:
    """Red planes subtracted, five taps, block argmax, centre of gravity: what a good user of OpenCV would write."""

    def __init__(self, rows: int, columns: int) -> None:
        """Allocate once."""
        self.red_on = np.empty((rows, columns), np.uint8)
        self.red_off = np.empty((rows, columns), np.uint8)
        self.light = np.empty((rows, columns), np.uint8)
        self.every = np.arange(columns)
        self.offsets = np.arange(-4, 5)[:, None]
        self.taps = np.array([1, 4, 6, 4, 1], np.float32) / 16

    def __call__(self, on: Frame, off: Frame) -> npt.NDArray[np.float32]:
        """Row of the stripe per column, NaN where the peak is below five sigma or 5 % of the median peak."""
        cv2.mixChannels([on], [self.red_on], [2, 0])
        cv2.mixChannels([off], [self.red_off], [2, 0])
        cv2.subtract(self.red_on, self.red_off, dst=self.light)
        smooth = cv2.sepFilter2D(self.light, cv2.CV_16S, np.ones(1, np.float32), 4 * self.taps)
        whole = smooth.shape[0] // 16 * 16
        best = smooth[:whole].reshape(-1, 16, smooth.shape[1]).max(axis=1).argmax(axis=0)
        rows = best * 16 + np.arange(16)[:, None]
        window = smooth[rows, self.every]
        inside = window.argmax(axis=0)
        top = rows[inside, self.every]
        peak = window[inside, self.every]
        around = np.clip(top + self.offsets, 0, len(smooth) - 1)
        weights = np.maximum(smooth[around, self.every] - 0.2 * peak, 0).astype(np.float32)
        total = weights.sum(axis=0)
        centre = top + (weights * self.offsets).sum(axis=0) / np.maximum(total, 1e-6)
        sample = smooth[::8, ::8]
        noise = 1.4826 * float(np.median(np.abs(sample - np.median(sample))))
        strong = peak > max(5 * noise, 0.05 * float(np.median(peak)))
        return np.where(strong, centre, np.nan).astype(np.float32)


def red_skeleton(skeleton: Callable[[Frame], npt.NDArray[Any]]) -> Contender:
    """The paper's way: Otsu on the red difference, a skeleton of the mask (0 and 255), mean row per column."""

    def extract(on: Frame, off: Frame) -> npt.NDArray[np.float32]:
        light = cv2.subtract(on[:, :, 2], off[:, :, 2])
        _, mask = cv2.threshold(light, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
        thin = skeleton(np.asarray(mask, np.uint8)) > 0
        count = thin.sum(axis=0)
        rows = (thin * np.arange(thin.shape[0])[:, None]).sum(axis=0)
        return np.where(count > 0, rows / np.maximum(count, 1), np.nan).astype(np.float32)

    return extract


def library_skeletons() -> dict[str, Contender]:
    """The paper's way with each library that is installed and makes skeletons; neither is in the lock file."""
    found: dict[str, Contender] = {}
    if find_spec("skimage") is not None:
        from skimage.morphology import skeletonize

        found["scikit-image"] = red_skeleton(lambda mask: skeletonize(mask > 0))
    if hasattr(cv2, "ximgproc"):
        found["OpenCV contrib"] = red_skeleton(cv2.ximgproc.thinning)
    return found


def contenders(rows: int, columns: int) -> dict[str, Contender]:
    """All that is compared, the reference first."""
    found: dict[str, Contender] = {REFERENCE: Reference(rows, columns), "floor: touch every byte": band_floor}
    found |= {f"ours: {name}": method for name, method in METHODS.items()}
    skeletons = library_skeletons()
    if not skeletons:
        print("neither scikit-image nor OpenCV's contrib modules are installed: no library's skeleton in the table")
    found |= {f"red + skeleton ({name})": extract for name, extract in skeletons.items()}
    return found


def measure(frames: list[tuple[Frame, Frame]]) -> dict[str, list[float]]:
    """Seconds per frame of each contender in each round; the order turns from round to round."""
    rows, columns = frames[0][0].shape[:2]
    every = contenders(rows, columns)
    names = list(every)
    seconds: dict[str, list[float]] = {name: [] for name in names}
    for name in names:
        every[name](*frames[0])
    for turn in range(ROUNDS):
        for name in names[turn % len(names) :] + names[: turn % len(names)]:
            run = every[name]
            start = time.process_time()
            for on, off in frames:
                run(on, off)
            seconds[name].append((time.process_time() - start) / len(frames))
    return seconds


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", default="clean", choices=[case.name for case in CASES])
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    case = next(case for case in CASES if case.name == arguments.case)
    seconds = measure([(on, off) for on, off, _ in stripes(case, count=FRAMES)])
    reference = np.array(seconds[REFERENCE])
    print(f"{FRAMES} frames, {ROUNDS} rounds, one thread; ratio to the reference of the same round: median [min max]")
    for name, times in seconds.items():
        ratio = np.array(times) / reference
        print(
            f"{name:<36} {np.median(times) * 1e3:7.3f} ms  "
            f"{np.median(ratio):6.2f} [{ratio.min():.2f} {ratio.max():.2f}]"
        )


if __name__ == "__main__":
    main()
