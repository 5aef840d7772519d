"""Metrics of a status in OpenMetrics text, read over HTTP with the parser of Prometheus."""

import json
import re
import urllib.request
from pathlib import Path

import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from guara_perception.app.metrics import COUNTERS, LEVEL, metric_name, metrics_served
from guara_perception.exceptions import InvalidInput
from tests.ports import free_port
from transport import Health, StatusItem

SCANNER = StatusItem(
    name="scanner",
    level=Health.WARN,
    message="degraded",
    values={
        "step": "7",
        "coverage": "0.953",
        "provisional": "true",
        "mode": "standard",
        "scans": "8",
        "gap": "",
        "links": 2,
    },
)
THREAD = StatusItem(name="thread guara-scans", level=Health.ERROR, message="not running")


def scrape(port: int) -> dict[str, float]:
    """Samples by name, and by item if they have one."""
    request = urllib.request.Request(
        f"http://127.0.0.1:{port}/metrics", headers={"Accept": "application/openmetrics-text; version=1.0.0"}
    )
    with urllib.request.urlopen(request, timeout=30) as answer:
        families = text_string_to_metric_families(answer.read().decode())
        return {
            sample.name + sample.labels.get("item", ""): sample.value
            for family in families
            for sample in family.samples
        }


def test_levels_and_numbers_of_the_status_are_metrics() -> None:
    """Texts and missing numbers are left out; increasing numbers are counters; process metrics are included."""
    with metrics_served(port := free_port(), "guara", lambda: [SCANNER, THREAD]):
        got = scrape(port)
    assert got["guara_status_levelscanner"] == 1 and got["guara_status_levelthread guara-scans"] == 2
    assert (got["guara_scanner_step"], got["guara_scanner_coverage"], got["guara_scanner_provisional"]) == (7, 0.953, 1)
    assert got["guara_scanner_scans_total"] == 8 and got["guara_scanner_links"] == 2
    assert got["guara_build_info"] == 1
    assert got["process_resident_memory_bytes"] > 1e6
    assert not {"guara_scanner_mode", "guara_scanner_gap"} & set(got)


def test_each_request_reads_the_status_of_now() -> None:
    steps = iter(range(100))
    with metrics_served(port := free_port(), "guara", lambda: [_at(next(steps))]):
        first, second = scrape(port), scrape(port)
    assert second["guara_scanner_step"] > first["guara_scanner_step"]


def test_a_port_in_use_is_refused() -> None:
    with metrics_served(port := free_port(), "guara", list):
        with pytest.raises(InvalidInput, match=f"--metrics is {port}: .*; allowed: a free port"):
            with metrics_served(port, "guara", list):
                pass


def test_names_of_metrics_have_no_other_characters() -> None:
    assert metric_name("thread guara-scans", "Last Try") == "guara_thread_guara_scans_last_try"


def _at(step: int) -> StatusItem:
    return StatusItem(name="scanner", level=Health.OK, message="", values={"step": str(step)})


def test_the_dashboard_asks_for_metrics_that_there_are(root: Path) -> None:
    """Each name in its panels is a metric of this module or of the Prometheus process collector."""
    dashboard = json.loads((root / "docs" / "grafana-dashboard.json").read_text())
    asked = {
        name
        for panel in dashboard["panels"]
        for target in panel["targets"]
        for name in re.findall(r"\b(?:guara|process)_\w+", target["expr"])
    }
    counted = {f"{name}_total" for name in COUNTERS}
    gauges = {LEVEL, *(metric_name("scanner", name) for name in ("coverage", "duration_s", "latency_ms"))}
    gauges |= {metric_name("light", name) for name in ("margin_clipped", "margin_steady", "stripe_level")}
    assert asked - counted - gauges == {"process_resident_memory_bytes", "process_cpu_seconds_total"}
