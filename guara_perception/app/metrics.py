"""OpenMetrics endpoint of a node on a local port: numbers of the node's status, and metrics of the process."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version

from prometheus_client import GC_COLLECTOR, PLATFORM_COLLECTOR, PROCESS_COLLECTOR, CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from guara_perception.exceptions import InvalidInput
from transport import StatusItem

ADDRESS = "127.0.0.1"
LEVEL = "guara_status_level"
# Metrics exported as counters; all others are gauges.
COUNTERS = {
    "guara_scanner_scans",
    "guara_scanner_failures",
    "guara_threads_failures",
    "guara_transport_published",
    "guara_transport_superseded",
    "guara_transport_failed",
    "guara_transport_answers",
    "guara_transport_answers_stale",
    "guara_withdrawn_moved",
    "guara_withdrawn_clock",
    "guara_withdrawn_late",
}
# Text of a status value that becomes a metric, such as "12.5".
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
WORDS = {"true": 1.0, "false": 0.0}


class StatusCollector(Collector):
    """Collector that converts the status items to metrics at each request.

    `guara_status_level{robot,item}` is the level of an item (0 ok, 1 warning, 2 error); `guara_<item>_<value>{robot}`
    is a value of an item, if it is a number, true (1) or false (0). Names of counters end with `_total`.
    `guara_build_info` contains the version.
    """

    def __init__(self, robot: str, items: Callable[[], list[StatusItem]]) -> None:
        """Create the collector; `items` returns the status items of `robot`."""
        self._robot, self._items = robot, items

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics of the current status."""
        names = ["robot", "item"]
        levels = GaugeMetricFamily(LEVEL, "Level of an item of the status: 0 ok, 1 warning, 2 error", labels=names)
        numbers: dict[str, float] = {}
        for item in self._items():
            levels.add_metric([self._robot, item.name], int(item.level))
            for name, given in item.values.items():
                text = str(given)
                value = WORDS.get(text, float(text) if NUMBER.fullmatch(text) else math.nan)
                if not math.isnan(value):
                    numbers[metric_name(item.name, name)] = value
        yield levels
        yield InfoMetricFamily("guara_build", "Version of the node", {"version": version("guara-perception")})
        for name, value in numbers.items():
            family = CounterMetricFamily if name in COUNTERS else GaugeMetricFamily
            metric = family(name, "Value of the status (docs/messages.md)", labels=["robot"])
            metric.add_metric([self._robot], value)
            yield metric


def metric_name(item: str, value: str) -> str:
    """Name of the metric for a value of a status item."""
    return re.sub(r"[^a-z0-9_]+", "_", f"guara_{item}_{value}".lower())


@contextmanager
def metrics_served(port: int, robot: str, items: Callable[[], list[StatusItem]]) -> Iterator[None]:
    """Serve the metrics of the status and of this process at http://127.0.0.1:PORT/metrics while the block runs.

    Raises:
        InvalidInput: the port is in use or not allowed.
    """
    registry = CollectorRegistry()
    for collector in (PROCESS_COLLECTOR, PLATFORM_COLLECTOR, GC_COLLECTOR, StatusCollector(robot, items)):
        registry.register(collector)
    try:
        server, thread = start_http_server(port, addr=ADDRESS, registry=registry)
    except OSError as error:
        raise InvalidInput(f"--metrics is {port}: {error.strerror}; allowed: a free port") from None
    try:
        yield
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
