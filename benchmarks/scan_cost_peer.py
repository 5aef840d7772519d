"""Process of `benchmarks.scan_cost` that scans with the code of one checkout.

It uses only functions that older revisions also have.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from pathlib import Path

import cv2

from testbed.scenes import recorded


def main_of_peer(scan: Path) -> None:
    """Scan once for each line of input, and print the processor time; the first line says that the process runs."""
    print("{}", flush=True)
    cv2.setNumThreads(1)
    in_memory = recorded(scan)
    for _ in sys.stdin:
        gc.collect()
        start = time.process_time()
        processor = in_memory.processor("precise")
        in_memory.add_to(processor)
        processor.finish()
        print(json.dumps({"seconds": time.process_time() - start}), flush=True)


if __name__ == "__main__":
    main_of_peer(Path(sys.argv[1]))
