"""Stripes that lie elsewhere than they should: orientation, order, pattern, raw pictures, a lifted mount."""

from __future__ import annotations

import dataclasses
import re
import struct
from collections.abc import Callable

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.scan_folder import read_picture
from guara_perception.scanning.coverage_diagnosis import advice
from guara_perception.simulation.specimen import rotation
from kinematics import RobotModel
from tests.thorough import IS_THOROUGH

SLIPS_DEG = (-12.0, -8.0, -5.0, 8.0, 12.0) if IS_THOROUGH else (-5.0, 8.0)


def spoiled(scan: gp.Scan, change: Callable[[int, np.ndarray], np.ndarray]) -> gp.Scan:
    """The scan with every frame changed; `change` gets its number in the scan, -1 for a shared laser-off frame."""
    index_of = {stripe.off: -1 for stripe in scan.stripes} | {stripe.on: k for k, stripe in enumerate(scan.stripes)}
    return dataclasses.replace(scan, read_frame=lambda name: change(index_of[name], scan.read_frame(name)))


def renamed(scan: gp.Scan, frames: list[str]) -> gp.Scan:
    """The scan with these frames for its last stripes, and without the other stripes."""
    stripes = tuple(dataclasses.replace(s, on=on) for s, on in zip(scan.stripes[-len(frames) :], frames, strict=True))
    return dataclasses.replace(scan, stripes=stripes)


def raw_bayer(frame: np.ndarray) -> np.ndarray:
    """Picture as a sensor behind a colour filter delivers it."""
    raw = frame[:, :, 1].copy()
    raw[::2, ::2], raw[1::2, 1::2] = frame[::2, ::2, 0], frame[1::2, 1::2, 2]
    return raw


def reasons(scan: gp.Scan, calibration: gp.Calibration, robot: RobotModel) -> tuple[gp.TerrainGrid, str]:
    terrain = gp.process_scan(scan, calibration, robot, pictures=False)
    assert terrain.metadata["health"]["level"] == "degraded"
    return terrain, terrain.metadata["health"]["reasons"][-1]


@pytest.mark.slow
def test_orientation_order_and_pattern_are_reported_before_the_laser_is_blamed(paper_scan, calibration, robot) -> None:
    """A good scan, spoiled in one way each: the reason names that way, and does not ask for a stronger laser."""
    frames = [stripe.on for stripe in paper_scan.stripes]
    every_second = dataclasses.replace(paper_scan, stripes=paper_scan.stripes[::2])
    cases = {
        "the frames are turned by 180 degrees": spoiled(paper_scan, lambda k, frame: cv2.rotate(frame, cv2.ROTATE_180)),
        "the frames are flipped top to bottom": spoiled(paper_scan, lambda k, frame: frame[::-1].copy()),
        r"\d+ of the \d+ frames examined are flipped top to bottom": spoiled(
            paper_scan, lambda k, frame: frame[::-1].copy() if k % 2 == 1 else frame
        ),
        r"\d+ of the \d+ frames examined are turned by 180 degrees": spoiled(
            paper_scan, lambda k, frame: cv2.rotate(frame, cv2.ROTATE_180) if k % 2 == 1 else frame
        ),
        "no two neighbouring stripes were fired.*every second stripe is missing": every_second,
        'a coarse scan was processed in mode "standard"': dataclasses.replace(paper_scan, mode="standard"),
        "the frames are in reverse order": renamed(paper_scan, frames[::-1]),
        "the frames are behind by 6 in stripe index": renamed(paper_scan, frames[:-3]),
    }
    for expected_text, scan in cases.items():
        _, reason = reasons(scan, calibration, robot)
        assert re.search(expected_text, reason), (expected_text, reason)
        assert "stronger laser" not in reason


@pytest.mark.slow
def test_raw_bayer_taken_as_grey_is_refused(paper_scan, calibration, robot) -> None:
    """Every frame that shows a stripe is refused, with what to do; in true grey the scan is good."""
    raw, _ = reasons(spoiled(paper_scan, lambda k, frame: raw_bayer(frame)), calibration, robot)
    assert raw.metadata["known"] == 0 and len(raw.metadata["frames_bad"]) > 30
    assert "the frame is raw Bayer data" in raw.metadata["health"]["reasons"][0]
    for change in (lambda k, frame: cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), lambda k, frame: frame[:, :, 2].copy()):
        grey = gp.process_scan(spoiled(paper_scan, change), calibration, robot, pictures=False)
        assert not grey.metadata["frames_bad"] and grey.metadata["known"] > 0.9


def test_the_advice_says_where_stripes_were_found() -> None:
    """Stripes too low or too high all over: the calibration is blamed first, not the laser."""
    counts = np.array([2000, 0, 0, 0, 0, 8000, 0])
    assert "8000 columns show a stripe where none can be, too high or too low" in advice(0.1, counts)
    assert "stronger laser" in advice(0.1, np.array([7000, 0, 0, 0, 0, 3000, 0]))
    assert "expose less" in advice(0.1, np.array([100, 0, 400, 200, 0, 300, 0]))
    assert advice(0.1, counts, "the frames are turned").endswith("returned laser light: the frames are turned")


def mount_lifted(calibration: gp.Calibration, height: float) -> gp.Calibration:
    """The calibration with camera and laser this much higher [m]."""
    transform = calibration.transform_camera_to_base.copy()
    transform[2, 3] += height
    return dataclasses.replace(calibration, transform_camera_to_base=transform)


def mirror_slipped(calibration: gp.Calibration, robot: RobotModel, degrees: float) -> gp.Calibration:
    """The calibration with every laser plane turned about the mirror's axis."""
    to_camera = np.linalg.inv(calibration.transform_camera_to_base)
    point = to_camera[:3, :3] @ robot.transform_laser_to_base[:3, 3] + to_camera[:3, 3]
    turn = rotation(np.deg2rad(degrees) * to_camera[:3, 1])
    stripes = []
    for stripe in calibration.stripes:
        normal = turn @ stripe.plane[:3]
        plane = np.append(normal, stripe.plane[3] + (stripe.plane[:3] - normal) @ point)
        stripes.append(dataclasses.replace(stripe, plane=plane))
    return dataclasses.replace(calibration, stripes=tuple(stripes))


@pytest.mark.slow
def test_not_found_found_elsewhere_and_not_usable_are_distinguished(paper_scan, calibration, robot) -> None:
    """A good scan with another calibration, without light, and with light that clips."""
    elsewhere = "where none can be, too high or too low: the calibration belongs to another rangefinder, the camera or"
    for moved_calibration in (
        *(mount_lifted(calibration, height) for height in (-0.1, 0.2)),
        *(mirror_slipped(calibration, robot, degrees) for degrees in SLIPS_DEG),
    ):
        _, reason = reasons(paper_scan, moved_calibration, robot)
        assert elsewhere in reason and "expose less" not in reason and "stronger laser" not in reason
    shared = paper_scan.stripes[0].off
    dark = dataclasses.replace(
        paper_scan, read_frame=lambda name: paper_scan.read_frame(shared if name != shared else name)
    )
    assert "check that the laser is on" in reasons(dark, calibration, robot)[1]
    clipped = spoiled(
        paper_scan, lambda k, frame: frame if k < 0 else np.where(frame > 60, 255, frame).astype(np.uint8)
    )
    assert "expose less" in reasons(clipped, calibration, robot)[1]


def with_orientation(picture: np.ndarray, orientation: int) -> bytes:
    """A JPEG file with this EXIF orientation."""
    content = cv2.imencode(".jpg", picture)[1].tobytes()
    tag = struct.pack("<2sHIHHHII", b"II", 42, 8, 1, 0x0112, 3, 1, orientation) + bytes(4)
    exif = b"Exif\0\0" + tag
    return content[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + content[2:]


@pytest.mark.slow
def test_exif_orientation_is_refused_in_one_way(paper_scan, calibration, robot, tmp_path) -> None:
    """A picture that is to be shown turned is refused; in a scan its stripe is lost and the report says why."""
    picture = paper_scan.read_frame(paper_scan.stripes[15].on)
    (tmp_path / "turned.jpg").write_bytes(with_orientation(picture, 3))
    (tmp_path / "normal.jpg").write_bytes(with_orientation(picture, 1))
    assert read_picture(tmp_path / "normal.jpg").shape == picture.shape
    with pytest.raises(gp.FileFormatError, match="EXIF orientation tag rotates or mirrors the image"):
        read_picture(tmp_path / "turned.jpg")
    names = [stripe.on for stripe in paper_scan.stripes]

    def read(name: str) -> np.ndarray:
        return read_picture(tmp_path / "turned.jpg") if name == names[15] else paper_scan.read_frame(name)

    mixed = gp.process_scan(dataclasses.replace(paper_scan, read_frame=read), calibration, robot, pictures=False)
    (reason,) = mixed.metadata["frames_bad"].values()
    assert "EXIF orientation" in reason
