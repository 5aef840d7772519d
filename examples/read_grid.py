"""Grid of a recorded scan, and its simplest queries: height, hazards, traversability and their explanation.

python examples/read_grid.py scans/paper calibration.json
"""

import numpy as np

import guara_perception as gp


def main(scan: str, calibration: str) -> None:
    """Process the scan and query three points ahead of the robot."""
    terrain = gp.process_scan(scan, calibration, pictures=False)
    print(terrain)
    for x, y in ((0.70, 0.00), (0.60, 0.18), (0.90, 0.10)):
        height = terrain.height_at(x, y)
        known = "unknown" if np.isnan(height) else f"{1e3 * height:.1f} mm"
        print(f"({x:.2f}, {y:+.2f}): {known}, {terrain.hazard_at(x, y)!r}, safe: {terrain.is_traversable(x, y)}")
        print("   " + terrain.explain(x, y))


if __name__ == "__main__":
    from arguments import call

    call(main)
