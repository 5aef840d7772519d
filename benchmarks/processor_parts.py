"""Splits the processor time of a running node by the part that spent it, on whichever thread."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

REST = "transport's threads and the rest"
EMULATED = ("emulated camera", "emulated board")


class ProcessorParts:
    """Clocks that run while their functions do; time in a called function with a clock of its own counts only there.

    Attributes:
        seconds: processor time by part.
    """

    def __init__(self) -> None:
        """Begin with nothing spent."""
        self.seconds: dict[str, float] = defaultdict(float)
        self._under_way = threading.local()

    def clocked(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, with what it spends counted under `part`."""

        def call(*args: Any, **keywords: Any) -> Any:
            inner = getattr(self._under_way, "inner", 0.0)
            self._under_way.inner = 0.0
            begun = time.thread_time()
            try:
                return function(*args, **keywords)
            finally:
                spent = time.thread_time() - begun
                self.seconds[part] += spent - self._under_way.inner
                self._under_way.inner = inner + spent

        return call


@contextmanager
def parts_of_the_node() -> Iterator[ProcessorParts]:
    """Put clocks on the parts of a node while the block lasts; costs about 3 microseconds a call."""
    from drivers.emulator.bus import LocalBus
    from drivers.emulator.emulated_camera import EmulatedCamera
    from drivers.sweep.acquisition import StripeStream
    from drivers.sweep.light_check import LightCheck
    from drivers.sweep.scan_worker import ScanWorker
    from guara_perception.app.node import pause_scanner
    from guara_perception.app.node.rangefinder import Rangefinder
    from guara_perception.scan_processor import ScanProcessor
    from transport.outbox import Outbox
    from transport.status_reporter import StatusReporter

    timed: tuple[tuple[str, Any, str], ...] = (
        ("emulated camera", EmulatedCamera, "grab"),
        ("emulated board", LocalBus, "control"),
        ("emulated board", LocalBus, "interrupt"),
        ("driver: board, camera, thread", ScanWorker, "run"),
        ("driver: proof of every stripe", StripeStream, "_judged"),
        ("driver: handing over", StripeStream, "_next_group"),
        ("scan: set up", ScanProcessor, "__init__"),
        ("scan: stripes", ScanProcessor, "add_all"),
        ("scan: finish", ScanProcessor, "finish"),
        ("check of drift", pause_scanner, "scan_drift"),
        ("check of the camera's settings", Rangefinder, "setting_changes"),
        ("check of the light", LightCheck, "look"),
        ("messages made", pause_scanner, "publish_terrain"),
        ("messages sent", Outbox, "post"),
        ("map", pause_scanner.WalkMap, "update"),
        ("node", pause_scanner.PauseScanner, "scan"),
        ("status", StatusReporter, "_report"),
    )
    parts = ProcessorParts()
    before = [(owner, name, getattr(owner, name)) for _, owner, name in timed]
    # Encoding and sending run later, on the outbox's thread: the posted action gets a clock of its own.
    post = Outbox.post

    def clocked_post(box: Outbox, key: str, action: Callable[[], None], **keywords: Any) -> None:
        post(box, key, parts.clocked("messages sent", action), **keywords)

    try:
        for part, owner, name in timed:
            setattr(owner, name, parts.clocked(part, getattr(owner, name)))
        setattr(Outbox, "post", clocked_post)  # noqa: B010
        yield parts
    finally:
        for owner, name, function in before:
            setattr(owner, name, function)
