"""Calibration report as a self-contained HTML file, and its summary as text."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from guara_perception.app.calibration_report import drawing
from guara_perception.app.calibration_report.drawing import data_url
from guara_perception.calibration.quality import Check
from guara_perception.calibration.result import CalibrationResult
from guara_perception.files import check_folder, write_text

REPORT_FILE = "report.html"
VERDICT_TEXTS = {
    "good": "This calibration is good. Use it.",
    "usable": "This calibration can be used, but it could be better. The reasons are below.",
    "refused": "Do not use this calibration: heights measured with it cannot be trusted. The reasons are below.",
}
PAGE = Path(__file__).with_name(REPORT_FILE)
STYLE = PAGE.with_suffix(".css").read_text(encoding="utf-8")
MOUNTS = {"eq5": "as eq. 5 of the paper (rows grow forward)", "upright": "upright (rows grow backward)"}
MARKS = {"good": "ok  ", "usable": "weak", "refused": "BAD "}


def write_report(result: CalibrationResult, folder: str | Path) -> Path:
    """Write `report.html` to a folder, which is created if needed; return the path of the file.

    Raises:
        InvalidInput: `folder` is a file.
    """
    folder = Path(folder)
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / REPORT_FILE
    write_text(path, report_page(result))
    return path


def report_page(result: CalibrationResult) -> str:
    """Render the whole page as HTML text. Sections without content are left out."""
    ground = result.session.ground_board_image if result.intrinsics.views else None
    halves = drawing.halves(result) if result.intrinsics.views else None
    page = PAGE.read_text(encoding="utf-8")
    sections = {
        "lens": result.intrinsics.views,
        "given": not result.intrinsics.views,
        "board": ground,
        "halves": halves,
    }
    for name, content in sections.items():
        if not content:
            page = re.sub(rf'<section id="{name}">.*?</section>\n', "", page, flags=re.DOTALL)
    drawn: dict[str, Callable[[CalibrationResult], Any]] = {
        **vars(drawing),
        "board_before_after": lambda _: drawing.board_before_after(result, str(ground)),
        "halves": lambda _: halves,
    }
    # Each image of the page has the name of the function that draws it.
    pictures = {name: data_url(drawn[name](result)) for name in re.findall(r'src="\$(\w+)"', page)}
    by_name = {check.name: check.value for check in result.checks}
    depth = 1e3 * float(np.ptp(result.area[0]))
    near, far = (100 * 2 * by_name[f"height sigma {where}"] / depth for where in ("near", "far"))
    return Template(page).substitute(
        pictures,
        style=STYLE,
        robot=escape(result.session.robot),
        verdict=result.verdict,
        meaning=VERDICT_TEXTS[result.verdict],
        reasons=_reasons(result),
        checks=_checks(result),
        found=_found(result),
        depth=f"{depth:.0f}",
        near=f"{near:.2f}",
        far=f"{far:.2f}",
    )


def table(rows: Iterable[Sequence[str]], head: Sequence[str] = ()) -> str:
    """Render an HTML table of escaped cells, with a heading if `head` is not empty."""
    lines = ["".join(f"<th>{escape(cell)}</th>" for cell in head)] if head else []
    lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def image(png: bytes, text: str) -> str:
    """Render an HTML image with an embedded PNG and `text` as its alternative text."""
    return f'<img alt="{escape(text)}" src="{data_url(png)}">'


def _reasons(result: CalibrationResult) -> str:
    if not result.reasons:
        return "<p>No problems were found.</p>"
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
    return table(rows)


def summary(result: CalibrationResult) -> str:
    """Summary of a calibration as text: verdict, camera, mount, laser, every check with its limits, and the reasons."""
    matrix, camera = result.fit.camera.matrix, result.fit.camera
    x, y, z = result.calibration.transform_camera_to_base[:3, 3]
    lines = [
        f"verdict: {result.verdict}",
        f"camera: {camera.size[0]}x{camera.size[1]} px, focal lengths {matrix[0, 0]:.2f} {matrix[1, 1]:.2f} px, "
        f"principal point {matrix[0, 2]:.2f} {matrix[1, 2]:.2f} px",
        f"mount: {MOUNTS[result.floor.mount]}, optical centre at {x:.4f} {y:.4f} {z:.4f} m in "
        f"base_link, {1e3 * result.fit.transform_camera_to_footprint[2, 3]:.1f} mm above the floor",
        f"laser: {len(result.calibration.stripes)} stripes, axis at {_axis(result)} in base_footprint",
        "checks (limit for good, limit for refused):",
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


def value_text(check: Check) -> str:
    """Value of a check with its unit, or "not found" for NaN."""
    return "not found" if np.isnan(check.value) else f"{check.value:.3g} {check.unit}"


def limits_text(check: Check) -> str:
    """Limits of a check as text: a value beyond the first is not good, a value beyond the second is refused."""
    side = ">=" if check.higher_is_better else "<="
    return f"({side} {check.usable_from:g}, {side} {check.refused_from:g})"


def _axis(result: CalibrationResult) -> str:
    point = result.laser.sweep.mirror.point
    return f"x {point[0]:.4f} z {point[2]:.4f} m"
