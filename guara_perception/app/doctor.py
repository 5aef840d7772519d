"""Checks of hardware, files and machine, as run by `guara doctor`."""

from __future__ import annotations

import errno
import shutil
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from drivers import AravisCamera, DriverError, LaserBoard, OpenCvCamera
from drivers.board.board_session import SWEEPS_SINCE
from drivers.board.usb_link import default_backend
from drivers.cameras.aravis_library import AravisDevice, find_aravis_cameras, trigger_lines
from drivers.cameras.camera import evidence_of
from drivers.errors import CameraBackendMissing
from guara_perception.app.devices_file import ARAVIS, Devices
from guara_perception.app.files.open_scan import open_scan
from guara_perception.calibration.calibration import Calibration, check_identity
from guara_perception.calibration.drift import DRIFTING, HOLDS
from guara_perception.calibration.file import load_calibration
from guara_perception.exceptions import PerceptionError
from guara_perception.scanning.process import run_scan
from kinematics import KinematicsError, load_robot
from transport import Health, TransportError

OK, SKIP, WARN, FAIL = "ok", "skip", "warn", "FAIL"
CHECKS = ("usb", "board", "camera", "cameras", "zenoh", "calibration", "drift", "disk", "speed", "certificates")
# Age above which a calibration is doubtful, since a mount may have been knocked [days]. The rig of the paper
# (docs/paper.md) was calibrated before each session.
CALIBRATION_AGE_DAYS = 30
# [byte] Free disk space below which a warning is given; it is enough for ten recorded standard scans with frames of
# 640 x 512 px.
DISK_BYTES = 1_000_000_000
NO_FLOOR = (
    "scan again with more floor in view; if the view already shows only flat, empty floor, the calibration belongs to "
    "another camera or mount"
)
# Time to extract a stripe of 1280x1024 px above which a warning is given [s]: just under half the frame interval at 30
# frames per second.
STRIPE_SECONDS = 0.015
# Folder in which the kernel lists video devices.
VIDEO_CLASS = Path("/sys/class/video4linux")


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check.

    Attributes:
        level: "ok", "skip" (not checked), "warn" or "FAIL".
        message: what was found, and a remedy if there is one.
    """

    level: str
    message: str


def examine(
    *,
    devices: Devices,
    calibration: Path | None,
    listen: str,
    folder: Path,
    scan: Path | None = None,
    checks: tuple[str, ...] = (),
    security: Path | None = None,
    robot: str | None = None,
) -> Iterator[tuple[str, Finding]]:
    """Run the checks one by one; yield the name and the finding of each check.

    Args:
        devices: camera with the settings to lock, and board.
        calibration: calibration file to check, or None.
        listen: endpoint on which the node would listen.
        folder: folder of the recordings, whose disk must have room.
        scan: recorded scan with floor in view, for the drift check; None = skip the check.
        checks: names of the checks to run; empty = all.
        security: security folder to check, or None.
        robot: name or folder of the robot of `scan`; None = as the scan says.
    """
    every: dict[str, tuple[Callable[..., Finding], *tuple[Any, ...]]] = {
        "usb": (check_usb,),
        "board": (check_board, devices),
        "camera": (check_camera, devices),
        "cameras": (check_cameras,),
        "zenoh": (check_endpoint, listen),
        "calibration": (check_calibration, calibration, devices),
        "drift": (check_scan_drift, calibration, scan, robot),
        "disk": (check_disk, folder),
        "speed": (check_speed,),
        "certificates": (check_certificates, security),
    }
    for name, check in every.items():
        if not checks or name in checks:
            yield name, attempt(*check)


def attempt(check: Callable[..., Finding], *arguments: Any) -> Finding:
    """Run a check; report an expected error that it raises as FAIL."""
    try:
        return check(*arguments)
    except (DriverError, PerceptionError, KinematicsError, TransportError, ValueError) as error:
        return Finding(FAIL, str(error))
    except OSError as error:
        return Finding(FAIL, str(error) if error.filename is None else f"{error.filename}: {error.strerror}")


def check_usb() -> Finding:
    """Check that pyusb finds a libusb backend."""
    return Finding(OK, f"backend {type(default_backend()).__module__}")


def check_board(devices: Devices) -> Finding:
    """Check that the laser board can be opened and supports the protocol."""
    with devices.laser_board() as board:
        identity = board.identity
    if not isinstance(board, LaserBoard):
        return Finding(OK, f"{devices.board['source']}: {np.degrees(identity.step_angle):.3f} degrees per step")
    firmware, protocol = (".".join(map(str, version)) for version in (identity.firmware, identity.protocol))
    sweeps = "can sweep by itself" if identity.protocol >= SWEEPS_SINCE else "cannot sweep by itself"
    return Finding(
        OK,
        f"firmware {firmware}, protocol {protocol} ({sweeps}), {np.degrees(identity.step_angle):.3f} degrees per step",
    )


def check_camera(devices: Devices) -> Finding:
    """Check that the camera is that of devices.toml, accepts its settings and delivers frames of the right size.

    If a trigger line is configured, the camera must have it. The message also says how the frames are verified.
    """
    held = ""
    triggered = devices.camera()
    with devices.camera(free=True) as camera:
        if devices.settings:
            locked = camera.lock(devices.camera_settings())
            held = "".join(f"{name} locked at {getattr(locked, name):g}; " for name in devices.settings)
        frame = camera.grab(2.0)
        check_identity(camera.identity, devices.identity, "the connected device")
        named = f" ({camera.identity})" if camera.identity else ""
    if triggered.triggered:
        # Opening fails if the camera does not have this trigger line.
        triggered.open()
        triggered.close()
    height, width = frame.image.shape[:2]
    text = f"camera {devices.source}{named} delivers {width}x{height} px; {held}it {evidence_of(triggered)}"
    if devices.size is not None and (width, height) != tuple(devices.size):
        wanted = f"{devices.size[0]}x{devices.size[1]}"
        return Finding(FAIL, f"{text}; devices.toml says {wanted}: a calibration is valid for one size only")
    return Finding(OK, text)


def check_cameras() -> Finding:
    """List the cameras and how the frames of each are verified."""
    found, missing = find_cameras()
    lines = [f"{camera.source}: {camera.evidence}" for camera in found] + ([missing] if missing else [])
    if not found:
        return Finding(WARN, "; ".join(["none found", *lines]))
    return Finding(OK, "; ".join(lines))


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """Camera found on this machine.

    Attributes:
        source: value for --camera and devices.toml.
        description: name or model, and connection.
        evidence: how the frames of the camera are verified, or the error if the camera cannot be opened.
        lines: lines on which the camera can be triggered, for --trigger; empty if none, or if it cannot be opened.
    """

    source: str
    description: str
    evidence: str
    lines: tuple[str, ...] = ()


def find_cameras() -> tuple[list[FoundCamera], str]:
    """Search for the cameras of this machine; takes a second or two.

    Returns:
        The cameras, and the reason why GigE Vision and USB3 Vision cameras could not be searched for, or "".
    """
    found = [_video(folder) for folder in sorted(VIDEO_CLASS.glob("video*"))]
    try:
        return found + [_aravis(device) for device in find_aravis_cameras()], ""
    except CameraBackendMissing as missing:
        return found, str(missing)


def _video(folder: Path) -> FoundCamera:
    path = f"/dev/{folder.name}"
    name = (folder / "name").read_text(errors="replace").strip()
    return FoundCamera(path, f"{name} (V4L2)", evidence_of(OpenCvCamera(path)))


def _aravis(device: AravisDevice) -> FoundCamera:
    description = f"{device.maker} {device.model} ({device.protocol}, {device.address})"
    source = f"{ARAVIS}:{device.name}"
    try:
        lines = trigger_lines(device.name)
    except DriverError as error:
        return FoundCamera(source, description, str(error))
    camera = AravisCamera(device.name, trigger=lines[0] if lines else None)
    return FoundCamera(source, description, evidence_of(camera), lines)


def check_endpoint(listen: str) -> Finding:
    """Check that the node can listen on an endpoint."""
    protocol, _, address = listen.partition("/")
    host, _, port = address.rpartition(":")
    if not port.isdigit():
        return Finding(FAIL, f"endpoint {listen!r} is not valid; allowed: protocol/host:port")
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host.strip("[]") or "127.0.0.1", int(port)))
        except OSError as error:
            stop = "stop the node that uses it, or " if error.errno == errno.EADDRINUSE else ""
            return Finding(FAIL, f"{listen}: {error.strerror}; {stop}choose another endpoint with --listen")
    return Finding(OK, f"{listen} is free ({protocol})")


def check_calibration(path: Path | None, devices: Devices) -> Finding:
    """Check that a calibration can be loaded and belongs to the camera in devices.toml; report its verdict and age."""
    if path is None:
        return Finding(WARN, "none given: give -c calibration.json, as written by `guara calibrate`")
    calibration = load_calibration(path)
    check_identity(devices.identity, calibration.camera.identity, "devices.toml")
    return judge_calibration(calibration)


def judge_calibration(calibration: Calibration) -> Finding:
    """Finding about the verdict and age of a calibration."""
    verdict = str(calibration.quality.get("verdict"))
    reasons = "; ".join(map(str, calibration.quality.get("reasons", ())))
    text = f"{verdict}{f' ({reasons})' if reasons else ''}, {len(calibration.stripes)} stripes"
    if verdict == "refused":
        return Finding(FAIL, f"{text}: calibrate again")
    try:
        made = datetime.fromisoformat(calibration.created)
    except ValueError:
        return Finding(WARN, f"{text}, of unknown age: calibrate again if in doubt")
    days = (datetime.now(UTC) - (made if made.tzinfo else made.replace(tzinfo=UTC))).days
    if days > CALIBRATION_AGE_DAYS:
        return Finding(WARN, f"{text}, {days} days old: check it on a flat floor, or calibrate again")
    return Finding(OK if verdict != "unknown" else WARN, f"{text}, {days} days old")


def check_scan_drift(calibration: Path | None, scan: Path | None, robot: str | None = None) -> Finding:
    """Check that the calibration still agrees with the floor in a scan."""
    if calibration is None or scan is None:
        return Finding(SKIP, "not checked: give -c calibration.json and --scan SCAN, a scan with floor in view")
    recorded, calibrated = open_scan(scan), load_calibration(calibration)
    drift = run_scan(recorded, calibrated, load_robot(robot or recorded.robot)).drift()
    if drift.verdict == DRIFTING:
        return Finding(WARN, f"{'; '.join(drift.reasons)}: calibrate again")
    if drift.verdict == HOLDS:
        floor, stripes = 1e3 * drift.floor_height, 1e3 * drift.stripe_rms
        return Finding(OK, f"the calibration holds: floor {floor:+.1f} mm, stripes {stripes:.2f} mm rms")
    return Finding(WARN, f"{'; '.join(drift.reasons)}: {NO_FLOOR}")


def check_disk(folder: Path) -> Finding:
    """Check that the disk has room for ten recorded scans."""
    free = shutil.disk_usage(folder).free
    text = f"{free / 1e9:.1f} GB free in {folder}"
    return Finding(OK, text) if free > DISK_BYTES else Finding(WARN, f"{text}: free some space for recordings")


def check_certificates(folder: Path | None) -> Finding:
    """Check a security folder: expiry of the certificates, permissions of the keys, version of the access rules."""
    if folder is None:
        return Finding(SKIP, "not checked: give --security DIR")
    from transport.security.certificates import judge_security

    level, message = judge_security(folder)
    return Finding({Health.OK: OK, Health.WARN: WARN}.get(level, FAIL), message)


def check_speed() -> Finding:
    """Check that this machine extracts stripes fast enough for a camera with 30 frames per second."""
    from guara_perception.stripes.extract import extract_stripe

    rows = np.arange(1024, dtype=np.float32)[:, None]
    centre = 500 + 5 * np.sin(np.arange(1280) / 90, dtype=np.float32)
    off = np.full((1024, 1280, 3), 40, np.uint8)
    off[::2] += 2
    on = off.copy()
    on[:, :, 2] += (120 * np.exp(-((rows - centre) ** 2) / 6)).astype(np.uint8)
    extract_stripe(on, off, band=(420, 580))
    start = time.perf_counter()
    for _ in range(5):
        extract_stripe(on, off, band=(420, 580))
    seconds = (time.perf_counter() - start) / 5
    text = f"{seconds * 1e3:.1f} ms per stripe of 1280x1024 px"
    if seconds > STRIPE_SECONDS:
        return Finding(WARN, f"{text}: too slow for 30 frames per second; stop other programs or scan coarsely")
    return Finding(OK, text)
