"""Heights of landing feet relative to the map, as reported in the status."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.node.consistency import ContactWatch
from guara_perception.app.node.node_status import NodeStatus
from guara_perception.terrain.layers.record import MapRecord
from transport import Health, StatusItem


def told(status: NodeStatus, name: str) -> StatusItem | None:
    return next((item for item in status.items() if item.name == name), None)


def fused(residuals: dict[str, float | None], **more: object) -> gp.TerrainGrid:
    """Map of a pause in which feet landed at these heights above it [m]."""
    flat = gp.assess_terrain(np.zeros((40, 40)), 0.005)
    record = MapRecord(robot="guara", limits=flat.record.required_limits, support_residuals=residuals, **more)
    return gp.TerrainGrid(layers=flat.layers, geometry=flat.geometry, extent="map", record=record)


@pytest.mark.parametrize(("bias", "level"), [(0.001, Health.OK), (0.012, Health.WARN), (-0.012, Health.WARN)])
def test_a_chain_that_is_off_is_alarmed(bias: float, level: Health) -> None:
    """A warning after eight landings; feet that stayed add nothing."""
    status = NodeStatus()
    watch, rng = ContactWatch(status), np.random.default_rng(0)
    for number in range(10):
        height = bias + rng.normal(0.0, 0.002)
        watch.add(fused({"lf": height, "rf": 1.0, "lh": None}), ("rf",))
        item = told(status, "contact")
        assert item is not None and item.values["landings"] == str(number + 1)
        assert item.level is (level if number >= 7 else Health.OK)
        assert item.values["last_worst_leg"] == "lf" and item.values["last_worst_mm"] == f"{1e3 * height:.1f}"
    assert float(item.values["bias_mm"]) == pytest.approx(1e3 * bias, abs=2.0)
    assert 0.5 < float(item.values["sigma_mm"]) < 4.0
    assert ("allowed: 5 mm" in item.message) == (level is Health.WARN)


def test_ground_that_gave_way_or_is_slippery_is_told_until_the_next_pause() -> None:
    status = NodeStatus()
    watch = ContactWatch(status)
    watch.add(fused({}, sunk_feet={"lh": 0.014}, slid_feet={"rf": 0.021}), ())
    item = told(status, "ground")
    assert item is not None and item.level is Health.WARN
    assert "gave way under lh by 14 mm" in item.message and "is slippery: rf slid by 21 mm" in item.message
    assert told(status, "contact") is None
    watch.add(fused({"lf": 0.0}), ())
    assert told(status, "ground") is None
