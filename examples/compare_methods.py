"""Comparison of the precise method with that of the paper, cell by cell.

python examples/compare_methods.py scans/paper calibration.json
"""

import guara_perception as gp


def main(scan: str, calibration: str) -> None:
    """Process the same frames with both methods."""
    grids = {m: gp.process_scan(scan, calibration, method=m, pictures=False) for m in ("precise", "paper")}
    for method, terrain in grids.items():
        print(f"{method}: {terrain}")
    print(gp.compare(grids["precise"], grids["paper"]))


if __name__ == "__main__":
    from arguments import call

    call(main)
