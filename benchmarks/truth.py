"""Makes a calibration file from the truth of a rendered data folder."""

from __future__ import annotations

import argparse
from pathlib import Path

import guara_perception as gp
from testbed.truth import truth_calibration


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="a data folder with calibration/truth.json and scans/")
    parser.add_argument("-o", "--out", type=Path, required=True, help="calibration.json to write")
    arguments = parser.parse_args()
    written = gp.save_calibration(truth_calibration(arguments.data), arguments.out)
    print(f"{arguments.out}: {len(written.stripes)} stripes, hash {written.hash}")


if __name__ == "__main__":
    main()
