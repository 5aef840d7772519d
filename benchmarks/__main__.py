"""`python -m benchmarks` lists the programs; `python -m benchmarks NAME ...` runs one, as `benchmarks.NAME` does.

All start with the linear algebra on one thread, as OpenCV is: no contender gets help that the others do not have.
"""

from __future__ import annotations

import importlib
import os
import sys

# Name of each program and what it prints; parts of a program are named first.
PROGRAMS = {
    "all": "speed and accuracy beside what a user would pick instead (make bench)",
    "accuracy": "error of recorded scans against their truth, and in the paper's own terms",
    "calibration": "error of calibrations against the truth of their session",
    "drift_check": "false alarms and finds of the check for a calibration that has drifted",
    "drift": "how far the fused map drifts aside, with and without laying scans onto it",
    "drivers": "costs of the laser board's driver and of proving stripes",
    "lines_of_sight": "whether bounds of unknown ground hold",
    "kinematics": "speed and agreement of the kinematics",
    "light": "each effect of real light on a scan: stripes found, wrong and made up, error of the heights",
    "map_cost": "what wide scans cost at the end of a pause, and steppable regions, beside the reference",
    "misplaced_crosses": "what misplaced crosses of a calibration do to the grid",
    "mosaics": "Bayer mosaics and grey frames through the whole chain, beside the truth",
    "mounting": "what a mount that moves costs, in heights",
    "node": "a running node: sweep, latency, processor time, memory",
    "photographs": "stripes on photographs of real laser lines, beside peers",
    "rangefinder": "both methods on recorded scans, in the paper's own terms",
    "real_photos": "the stripes of public photographs",
    "record_restarts": "nodes that record, killed again and again: how many come up, which files open",
    "robots": "stock quadrupeds from their URDF to a walk (extra robots-test)",
    "scan_cost": "processor time of a scan on this checkout beside another, and by path of its stripes",
    "simulation": "walks through simulated worlds, with the true ground beside",
    "size": "code lines, modules, words, commands, options and names of the project; the way of a frame to bytes",
    "soak": "nodes and planners killed for minutes, and what was lost",
    "stripe_pictures": "pictures of found stripes, good and bad",
    "stillness": "still pauses withdrawn and motions missed by noisy joints, before and now (extra robots-test)",
    "stripes": "error of stripe extraction where the centre is known",
    "sweeps": "triggered and free-running sweeps against the bound of the motion",
    "terrain": "speed and safety of the layers and of the map",
    "transport": "messages, viewers, announcements, fleet, compact: delays, faults, floods, many robots, encodings",
    "triggered_node": "guara run over the firmware on its chip and a GigE Vision camera that it triggers",
    "truth": "a calibration made of the truth of rendered data",
    "usable_ground": "ground that a planner may use, beside the truth",
}


def main() -> None:
    """Command line."""
    # Before numpy is loaded.
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if name in ("-h", "--help"):
        print("\n".join(f"{program:<14} {prints}" for program, prints in PROGRAMS.items()))
        return
    if name not in PROGRAMS:
        sys.exit(f"benchmarks: no program {name!r}; allowed: {', '.join(PROGRAMS)}")
    del sys.argv[1]
    sys.argv[0] = f"benchmarks {name}"
    importlib.import_module(f"benchmarks.{name}").main()


if __name__ == "__main__":
    main()
