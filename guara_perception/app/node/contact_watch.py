"""Monitor of foot contacts: heights of landing feet relative to the map, as a test of calibration and kinematics."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection

import numpy as np

from guara_perception.app.node.node_status import NodeStatus
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.record import MapRecord
from transport import Health

# Largest number of landings in the statistics, and smallest number for a warning (two cycles).
MOST_LANDINGS, FEWEST_LANDINGS = 40, 8


class ContactWatch:
    """Monitor with two status items.

    `contact` has bias and sigma of the latest landings, and the worst landing of the last pause with landings. `ground`
    reports feet that sank or slid.
    """

    def __init__(self, status: NodeStatus) -> None:
        """Start without landings; `status` gets the items."""
        self._status = status
        self._heights: deque[float] = deque(maxlen=MOST_LANDINGS)

    def add(self, fused: TerrainGrid, stayed: Collection[str]) -> None:
        """Add the feet that landed since the last pause, and update the status items.

        Args:
            fused: map of the pause.
            stayed: feet that did not swing since the last pause.
        """
        record = fused.record
        assert isinstance(record, MapRecord)
        sunk, slid = record.sunk_feet or {}, record.slid_feet or {}
        told = [f"gave way under {leg} by {1e3 * depth:.0f} mm" for leg, depth in sunk.items()]
        told += [f"is slippery: {leg} slid by {1e3 * way:.0f} mm" for leg, way in slid.items()]
        self._status.note("ground", f"step {fused.step}: the ground {' and '.join(told)}" if told else "")
        residuals = record.support_residuals or {}
        landed = {leg: height for leg, height in residuals.items() if height is not None and leg not in stayed}
        self._heights.extend(landed.values())
        if not landed:
            return
        worst = max(landed, key=lambda leg: abs(landed[leg]))
        bias, sigma, count = float(np.mean(self._heights)), float(np.std(self._heights)), len(self._heights)
        values = {
            "landings": str(count),
            "bias_mm": f"{1e3 * bias:.1f}",
            "sigma_mm": f"{1e3 * sigma:.1f}",
            "last_worst_mm": f"{1e3 * landed[worst]:.1f}",
            "last_worst_leg": worst,
        }
        limit = record.required_limits.sigma
        text, level = f"feet land {1e3 * bias:+.1f} mm off the map, sigma {1e3 * sigma:.1f} mm", Health.OK
        # Without a fault, the mean is within the limit plus two standard errors of the mean.
        if count >= FEWEST_LANDINGS and abs(bias) > limit + 2 * sigma / np.sqrt(count):
            level = Health.WARN
            text += (
                f"; allowed: {1e3 * limit:.0f} mm. The calibration, the joint zeros or the sole size is wrong, or the "
                "ground gives way everywhere"
            )
        self._status.note("contact", text, level, values)
