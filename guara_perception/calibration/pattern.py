"""Laser planes of stripes that were not calibrated, for instance to use a coarse calibration for standard scans."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from guara_perception.arrays import Float, Index
from guara_perception.calibration.calibration import Calibration, StripePlane, format_indices
from guara_perception.calibration.height_sigma import HeightUncertainty
from guara_perception.calibration.mirror_model import MirrorModel
from guara_perception.calibration.stripe_planes import plane_basis
from guara_perception.exceptions import CalibrationMismatch, FileFormatError
from guara_perception.fields import Fields

# Periods of the stepper's error that are tried [stripes of the standard pattern]. If every other stripe is calibrated,
# periods shorter than four stripes cannot be distinguished.
PERIODS = np.arange(4.0, 40.0, 0.25)
# Least share of the errors' variance that a wave must explain to be used; otherwise the errors are interpolated.
MIN_EXPLAINED = 0.8


def interpolate_pattern(calibration: Calibration, indices: Iterable[int]) -> Calibration:
    """Derive a calibration with exactly the given stripes.

    Calibrated stripes keep their planes. Other stripes get the plane of the mirror model at their angle, corrected by
    the estimated step error. If the calibration stores covariances, the planes of other stripes get larger ones.

    Args:
        calibration: calibration with a mirror model, as computed by `calibrate`; the model is needed only if a stripe
            is missing.
        indices: two or more indices in the standard pattern, outside the calibrated range by at most the largest
            spacing of the calibrated indices.

    Raises:
        CalibrationMismatch: there is no index, an index is too far outside, or the mirror model is missing.
        FileFormatError: the stored mirror model or covariance does not follow the documentation.
        InvalidInput: there is a single index, an index is negative, or a stored vector does not have unit length.
    """
    wanted = sorted(set(indices))
    known = np.array(calibration.indices)
    spacing = int(np.diff(known).max())
    outside = tuple(i for i in wanted if i < known[0] - spacing or i > known[-1] + spacing)
    if outside or not wanted:
        given = f"stripe index {format_indices(outside)}" if outside else "a pattern without stripes"
        raise CalibrationMismatch(
            f"{given} cannot be derived from a calibration of "
            f"{format_indices(calibration.indices)}; allowed: indices at most {spacing} outside"
        )
    missing = [i for i in wanted if i not in set(calibration.indices)]
    kept = [stripe for stripe in calibration.stripes if stripe.index in set(wanted)]
    uncertainty = HeightUncertainty.of(calibration)
    known_planes = {} if uncertainty is None else uncertainty.planes
    planes = {s.index: known_planes[s.index] for s in kept if s.index in known_planes}
    if missing:
        mirror, indices_of_errors, errors = stored_mirror(calibration)
        commanded = np.array([stripe.mirror_angle for stripe in calibration.stripes])
        angles = _extended(np.array(missing, dtype=float), known, commanded)
        guessed, sigma = step_errors(np.array(missing, dtype=float), indices_of_errors, errors)
        for index, angle, plane in zip(missing, angles, mirror.planes(angles + guessed), strict=True):
            kept.append(StripePlane(index, float(angle), plane))
            if uncertainty is not None:
                turn = plane_basis(plane, mirror)[0]
                # The laser plane turns by twice the mirror angle.
                planes[index] = uncertainty.plane_covariances([index])[0] + (2 * sigma) ** 2 * np.outer(turn, turn)
    covariance = calibration.covariance
    if uncertainty is not None:
        covariance = {**(covariance or {}), **dataclasses.replace(uncertainty, planes=planes).to_dict()}
    record = dict(calibration.mirror or {})
    record["filled_in"] = sorted({*record.get("filled_in", []), *missing} & set(wanted))
    return dataclasses.replace(
        calibration, stripes=tuple(kept), covariance=covariance, mirror=record, hash="", created=""
    )


def stored_mirror(calibration: Calibration) -> tuple[MirrorModel, Float, Float]:
    """Read the mirror model of a calibration, in the camera frame, with indices and step errors [rad] of its stripes.

    Raises:
        CalibrationMismatch: the calibration has no mirror model.
        FileFormatError: the stored mirror model does not follow the documentation.
    """
    if not calibration.mirror:
        raise CalibrationMismatch("the calibration has no mirror model: create it with `guara calibrate`")
    stored = Fields(calibration.mirror, "calibration", "mirror")
    sizes = {"laser_plane": 4, "axis": 3, "point": 3, "normal_at_zero": 3}
    vectors = {name: stored.array(name, (size,)) for name, size in sizes.items()}
    errors = [(item.number("index"), item.number("error")) for item in stored.items("step_errors")]
    if not errors:
        raise FileFormatError(f"{stored.path_to('step_errors')} is empty; allowed: the error of each calibrated stripe")
    return MirrorModel(**vectors, gain=stored.number("gain")), *np.array(errors).reshape(-1, 2).T


def step_errors(wanted: Float, indices: Float, errors: Float) -> tuple[Float, float]:
    """Estimate the errors of the mirror's position at other stripes [rad], and their standard deviation.

    The error of a stepper is periodic in its steps. If there are nine or more known errors and a single sine wave fits
    them, the wave is evaluated; otherwise the errors of neighbouring stripes are interpolated.

    Args:
        wanted: (n,) indices of the stripes.
        indices: (s,) indices of stripes with known errors, ascending.
        errors: (s,) known errors [rad].
    """
    variance = float(np.var(errors))
    if len(indices) > 8 and variance > 0:
        fits = [(_wave(indices, errors, period), period) for period in PERIODS]
        (coefficients, left), period = min(fits, key=lambda fit: fit[0][1])
        if left < (1 - MIN_EXPLAINED) * variance:
            return np.asarray(_wave_terms(wanted, period) @ coefficients), float(np.sqrt(left))
    return np.asarray(np.interp(wanted, indices, errors)), float(np.sqrt(2 * variance))


def _wave(indices: Float, errors: Float, period: float) -> tuple[Float, float]:
    terms = _wave_terms(indices, period)
    coefficients = np.linalg.lstsq(terms, errors, rcond=None)[0]
    return np.asarray(coefficients), float(np.var(errors - terms @ coefficients))


def _wave_terms(indices: Float, period: float) -> Float:
    phase = 2 * np.pi * indices / period
    return np.column_stack((np.ones(len(indices)), np.cos(phase), np.sin(phase)))


def _extended(wanted: Float, indices: Index, angles: Float) -> Float:
    """Commanded angles at other indices, interpolated or, beyond the ends, extrapolated with the spacing there."""
    inside = np.interp(wanted, indices, angles)
    slopes = np.diff(angles) / np.diff(indices)
    below = np.minimum(wanted - indices[0], 0) * slopes[0]
    return np.asarray(inside + below + np.maximum(wanted - indices[-1], 0) * slopes[-1])
