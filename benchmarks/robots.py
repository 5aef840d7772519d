"""Any robot: how the stock quadruped URDFs of the package index load, become folders, are checked and walk.

`python -m benchmarks.robots [--no-walk] [NAME ...]`; needs the extra `robots-test`.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

from guara_perception.app.main import ENVIRONMENT
from testbed.stock_results import line, stock_result
from testbed.stock_robots import FILES, StockRobotsMissing

# As the command does: before numpy is loaded.
os.environ.update(ENVIRONMENT)


def main() -> None:
    """Print every robot and how many pass; exit 1 unless all do."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(FILES), metavar="NAME", help=f"of: {', '.join(FILES)}")
    parser.add_argument(
        "--no-walk", action="store_true", help="without the simulated walk (15 s of processor time each)"
    )
    options = parser.parse_args()
    unknown = sorted(set(options.names) - set(FILES))
    if unknown:
        parser.error(f"no stock robot {unknown[0]!r}; there are: {', '.join(FILES)}")
    cv2.setNumThreads(1)
    results = []
    with tempfile.TemporaryDirectory() as made:
        for name in options.names:
            try:
                results.append(stock_result(name, Path(made) / name, with_walk=not options.no_walk))
            except StockRobotsMissing as error:
                print(error, file=sys.stderr)
                sys.exit(2)
            print(line(results[-1]), flush=True)
    loaded = sum(not result.error for result in results)
    sound = sum(not result.error and not result.findings for result in results)
    print(f"{loaded} of {len(results)} load, {sound} are sound", end="")
    if not options.no_walk:
        walked = sum(result.walk is not None and result.walk.is_passed for result in results)
        print(f", {walked} walk ten pauses with nothing unknown called safe and no foot on a hazard", end="")
    worst = np.nanmax([result.difference for result in results], initial=0.0)
    print(f"; stance pose within {worst:.0e} m of yourdfpy's")
    sys.exit(0 if all(result.is_passed for result in results) else 1)


if __name__ == "__main__":
    main()
