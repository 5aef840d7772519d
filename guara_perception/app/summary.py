"""Summary of a grid: one line of text for a person, plain values for a program."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, cells_by_flag
from guara_perception.terrain.layers.record import ScanRecord


def facts(terrain: TerrainGrid) -> dict[str, Any]:
    """Plain values that summarise a grid, as `--json` prints them."""
    hazard, record = terrain.hazard, terrain.record
    return {
        "robot": record.robot,
        "extent": terrain.extent,
        "step": terrain.step,
        "stamp": terrain.stamp,
        "mode": record.mode,
        "method": record.method,
        "cells": [terrain.shape[1], terrain.shape[0]],
        "resolution": terrain.resolution,
        "origin": list(terrain.origin),
        "known": float(np.mean((hazard & UNKNOWN_MASK) == 0)),
        "traversable": float(np.mean(terrain.traversability > 0)),
        "hazards": {name: count for name, count in cells_by_flag(hazard).items() if count},
        "health": asdict(record.health) if record.health else {},
        "calibration_hash": record.calibration_hash,
    }


def summary(terrain: TerrainGrid) -> str:
    """One-line summary of a grid, with the four most frequent flags and the reasons for its health level."""
    found, record = facts(terrain), terrain.record
    hazards: dict[str, int] = found["hazards"]
    most = sorted(hazards, key=lambda name: -hazards[name])[:4]
    parts = [
        f"step {terrain.step}",
        record.mode or "?",
        f"{terrain.shape[1]}x{terrain.shape[0]} cells of {terrain.resolution * 1e3:g} mm",
        f"known {found['known']:.0%}",
        f"traversable {found['traversable']:.0%}",
        f"attitude from {record.attitude_source or '?'}",
        "provisional" if terrain.is_provisional else "",
        "no dark flashes" if isinstance(record, ScanRecord) and record.dark_flashes is None else "",
        "hazards " + " ".join(f"{name} {hazards[name]}" for name in most) if most else "",
        "; ".join(record.health.reasons) if record.health else "",
    ]
    return ", ".join(filter(None, parts))
