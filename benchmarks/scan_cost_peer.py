"""Process of `benchmarks.scan_cost` that scans with the code of one checkout.

It uses only functions that older revisions also have.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def clocked(seconds: list[float], function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, which then appends the processor time of each call to `seconds`."""

    def call(*args: Any, **keywords: Any) -> Any:
        start = time.process_time()
        found = function(*args, **keywords)
        seconds.append(time.process_time() - start)
        return found

    return call


def sorted_by_path(precise: Any, finder: Any) -> tuple[list[float], list[float]]:
    """Lists that fill with the seconds of each stripe: by its highest peaks, and in any light."""
    cheap: list[float] = []
    strong: list[float] = []
    in_any_light: list[float] = []
    # Before it took one band, `extract_precise` called `_extract` for each.
    module, name = (precise, "_extract") if hasattr(precise, "_extract") else (finder, "extract_precise")
    of_band = getattr(module, name)
    precise.extract_in_any_light = clocked(in_any_light, precise.extract_in_any_light)

    def sort(band: Any) -> Any:
        before, start = len(in_any_light), time.process_time()
        found = of_band(band)
        (strong if len(in_any_light) > before else cheap).append(time.process_time() - start)
        return found

    setattr(module, name, sort)
    return cheap, strong


def main_of_peer(scan: Path) -> None:
    """Scan once for each line of input, and print what it took; the first line says that the process runs."""
    import cv2

    print("{}", flush=True)
    cv2.setNumThreads(1)
    in_memory = import_module("testbed.scenes").recorded(scan)
    modules = "guara_perception.stripes.precise", "guara_perception.scanning.stripe_finder"
    by_path = sorted_by_path(*map(import_module, modules))
    for _ in sys.stdin:
        for seconds_of_stripes in by_path:
            seconds_of_stripes.clear()
        gc.collect()
        start = time.process_time()
        processor = in_memory.processor("precise")
        in_memory.add_to(processor)
        processor.finish()
        seconds = time.process_time() - start
        cheap, strong = by_path
        report = {"scan": seconds, "stripes": len(in_memory.frames), "cheap": cheap, "strong": strong}
        print(json.dumps(report), flush=True)


if __name__ == "__main__":
    main_of_peer(Path(sys.argv[1]))
