"""Calibration report as a self-contained HTML file, and its summary as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

import numpy as np

from guara_perception.app.calibration_report import drawing
from guara_perception.app.calibration_report.drawing import data_url
from guara_perception.calibration.quality import Check
from guara_perception.calibration.result import CalibrationResult
from guara_perception.files import check_folder, whole_file

REPORT_FILE = "report.html"
VERDICT_TEXTS = {
    "good": "This calibration is good. Use it.",
    "usable": "This calibration can be used, but something could be better. The reasons are below.",
    "refused": "Do not use this calibration: heights measured with it cannot be trusted. The reasons are below.",
}
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 60rem; margin: 2rem auto; padding: 0 1rem }
h2 { margin-top: 2.2rem; border-bottom: 1px solid #ccc } img { max-width: 100%; display: block; margin: .6rem 0 }
table { border-collapse: collapse; font-size: .92rem } td, th { padding: .25rem .6rem; text-align: left;
vertical-align: top; border-bottom: 1px solid #ddd } td.number { white-space: nowrap; text-align: right }
.verdict { padding: .8rem 1rem; border-radius: .4rem; color: white; font-size: 1.15rem }
.good { background: #00805a } .usable { background: #b37400 } .refused { background: #b3330e }
td span { color: white; border-radius: .3rem; padding: 0 .4rem } .note { color: #555 }
"""
MARKS = {"good": "ok  ", "usable": "weak", "refused": "BAD "}


def write_report(result: CalibrationResult, folder: str | Path) -> Path:
    """Draw and write `report.html` into a folder, which is created if needed; return its path.

    Raises:
        InvalidInput: `folder` is a file.
    """
    folder = Path(folder)
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / REPORT_FILE
    with whole_file(path) as temporary:
        temporary.write_text(report_page(result), encoding="utf-8")
    return path


def report_page(result: CalibrationResult) -> str:
    """HTML text of the whole page."""
    parts = [
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Calibration report</title><style>{STYLE}</style>',
        f"<h1>Calibration of {escape(result.session.robot)}</h1>",
        f'<p class="verdict {result.verdict}"><b>{result.verdict}</b>: {VERDICT_TEXTS[result.verdict]}</p>',
        _reasons(result),
        "<h2>The numbers behind the verdict</h2>",
        _checks(result),
        _found(result),
        *_lens(result),
        "<h2>Where the camera sits: the crosses on the floor</h2>",
        "<p>The crosses are at positions measured with a tape. Detected and expected positions should coincide.</p>",
        image(drawing.fiducials(result), "fiducials"),
        "<h2>The laser planes</h2>",
        "<p>A turning mirror projects the laser onto the floor as one line after another. Scans of a flat plate at "
        "known heights determine each laser plane in space.</p>",
        image(drawing.side_view(result), "laser planes from the side"),
        image(drawing.stripes_over_plate(result), "stripes over plates"),
        "<h2>How well heights are measured</h2>",
        "<p>Left: height errors on the plates; values near zero are good, a slope or a step is not. Right, the "
        "stricter test: each plate measured with laser planes fitted to the other plates only.</p>",
        image(drawing.plate_errors(result), "height errors on the plates"),
        "<p>Expected height error of a scan (one standard deviation):</p>",
        image(drawing.height_sigma(result), "predicted sigma of heights"),
        _paper(result),
        "<h2>The mirror</h2>",
        "<p>A regular wave is caused by the motor; a jump would be a missed step.</p>",
        image(drawing.mirror_steps(result), "mirror steps"),
        "</html>",
    ]
    return "\n".join(parts)


def _lens(result: CalibrationResult) -> list[str]:
    """Figures of the lens: corners of the board and their errors."""
    if not result.intrinsics.views:
        return ["<p>The lens was given; no picture of a board checks it.</p>"]
    parts = []
    ground = result.session.ground_board_image
    if ground is not None:
        parts = [
            "<h2>The board, before and after</h2>",
            "<p>A lens bends straight lines and a tilted view makes far squares small. If lens and mount are right, "
            "the board has even squares when it is rectified to a view from straight above.</p>",
            image(drawing.board_before_after(result, ground), "board before and after correction"),
        ]
    parts += [
        "<h2>Does the lens model fit?</h2>",
        "<p>Each arrow is the residual of one corner of the board, enlarged. Arrows in all directions are noise; "
        "arrows like their neighbours (for instance all outward in one corner) mean a bent board or a wrong model. A "
        "picture with a long bar is blurred, or the board moved.</p>",
        image(drawing.corner_residuals(result), "corner errors"),
        "<h2>Was the whole picture used?</h2>",
        "<p>The lens is only calibrated where the board was seen. On the right, the resulting position error of points "
        "on the floor.</p>",
        image(drawing.coverage_and_sigma(result), "coverage and uncertainty"),
    ]
    halves = drawing.halves(result)
    if halves is not None:
        parts += [
            "<p>A small error proves little: a wrong model can fit its own pictures well. The lens is therefore "
            "calibrated twice, from every other picture, and the two must agree:</p>",
            image(halves, "difference between the two halves"),
        ]
    return parts


def table(rows: Iterable[Sequence[str]], head: Sequence[str] = ()) -> str:
    """Table of escaped cells, with a heading or without."""
    lines = ["".join(f"<th>{escape(cell)}</th>" for cell in head)] if head else []
    lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def image(png: bytes, text: str) -> str:
    """Picture within the page, and its text for those who do not see it."""
    return f'<img alt="{escape(text)}" src="{data_url(png)}">'


def _reasons(result: CalibrationResult) -> str:
    if not result.reasons:
        return "<p>Nothing to complain about.</p>"
    return "<ul>" + "".join(f"<li>{escape(reason)}</li>" for reason in result.reasons) + "</ul>"


def _checks(result: CalibrationResult) -> str:
    rows = [
        f'<tr><td>{escape(check.name)}</td><td class="number">{escape(value_text(check))}</td>'
        f'<td class="number">{escape(limits_text(check))}</td>'
        f'<td><span class="{check.verdict}">{check.verdict}</span></td><td>{escape(check.meaning)}</td></tr>'
        for check in result.checks
    ]
    head = "<tr><th>number</th><th>found</th><th>limits: good, refused</th><th></th><th>what it means</th></tr>"
    return f"<table>{head}{''.join(rows)}</table>"


def _found(result: CalibrationResult) -> str:
    camera, fit = result.fit.camera, result.fit
    matrix, misfit = camera.matrix, 1e3 * result.surface.rms
    sigma = dict(zip(fit.free, fit.covariance.diagonal() ** 0.5, strict=False))
    x, y, z = result.calibration.transform_camera_to_base[:3, 3]
    lens = ", ".join(f"{name} {value:+.5f}" for name, value in zip(fit.free[4:], fit.lens[4:], strict=True))
    rows = (
        ("picture", f"{camera.size[0]} x {camera.size[1]} px"),
        ("focal lengths", f"{matrix[0, 0]:.2f} +- {sigma['fx']:.2f} px, {matrix[1, 1]:.2f} +- {sigma['fy']:.2f} px"),
        ("principal point", f"{matrix[0, 2]:.2f} +- {sigma['cx']:.2f} px, {matrix[1, 2]:.2f} +- {sigma['cy']:.2f} px"),
        ("distortion", lens),
        ("mount", MOUNTS[result.floor.mount]),
        ("optical centre in base_link", f"{x:.4f}, {y:.4f}, {z:.4f} m"),
        ("height above the floor (H)", f"{1e3 * fit.transform_camera_to_footprint[2, 3]:.2f} mm"),
        ("floor homography", f"condition number {result.surface.condition:.1f}, misfit {misfit:.3f} mm"),
        ("stripes", str(len(result.calibration.stripes))),
    )
    return f"<h2>What was found</h2>{table(rows)}"


def _paper(result: CalibrationResult) -> str:
    """Height errors as the paper states them, in per cent of the surface's depth, near and far."""
    by_name = {check.name: check.value for check in result.checks}
    depth = 1e3 * (drawing.AREA_X[1] - drawing.AREA_X[0])
    near, far = (100 * 2 * by_name[f"height sigma {where}"] / depth for where in ("near", "far"))
    return (
        f'<p class="note">In the terms of the paper, as per cent of the {depth:.0f} mm deep surface (two '
        f"standard deviations): +-{near:.2f} % for near objects, +-{far:.2f} % for far ones (paper: 0.5 %, 2.5 %).</p>"
    )


def summary(result: CalibrationResult) -> str:
    """Verdict, lens, mount, every check with its limits, and the reasons."""
    matrix, camera = result.fit.camera.matrix, result.fit.camera
    x, y, z = result.calibration.transform_camera_to_base[:3, 3]
    lines = [
        f"verdict: {result.verdict}",
        f"camera: {camera.size[0]}x{camera.size[1]} px, focal lengths {matrix[0, 0]:.2f} {matrix[1, 1]:.2f} px, "
        f"principal point {matrix[0, 2]:.2f} {matrix[1, 2]:.2f} px",
        f"mount: {MOUNTS[result.floor.mount]}, optical centre at {x:.4f} {y:.4f} {z:.4f} m in "
        f"base_link, {1e3 * result.fit.transform_camera_to_footprint[2, 3]:.1f} mm above the floor",
        f"laser: {len(result.calibration.stripes)} stripes, axis at {_axis(result)} in base_footprint",
        "checks (limit of good, limit of refused):",
    ]
    width = max(len(check.name) for check in result.checks)
    lines += [
        f"  {MARKS[check.verdict]} {check.name:<{width}}  {value_text(check):>13}  {limits_text(check)}"
        for check in result.checks
    ]
    if result.reasons:
        lines.append("because:")
        lines += [f"  - {reason}" for reason in result.reasons]
    return "\n".join(lines)


MOUNTS = {"eq5": "as eq. 5 of the paper (rows grow forward)", "upright": "upright (rows grow backward)"}


def value_text(check: Check) -> str:
    """Value of a check with its unit."""
    return "not found" if np.isnan(check.value) else f"{check.value:.3g} {check.unit}"


def limits_text(check: Check) -> str:
    """Limits of good and of refused, with the sign of the side on which values are good."""
    side = ">=" if check.higher_is_better else "<="
    return f"({side} {check.usable_from:g}, {side} {check.refused_from:g})"


def _axis(result: CalibrationResult) -> str:
    point = result.laser.sweep.mirror.point
    return f"x {point[0]:.4f} z {point[2]:.4f} m"
