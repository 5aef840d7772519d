"""Recording of a walk: its grids and pauses, and a scan that is processed again at another resolution.

python examples/read_recording.py walk.mcap
"""

import guara_perception as gp


def main(path: str) -> None:
    """List the content, then process the frames of the first scan."""
    with gp.open_recording(path) as recording:
        for terrain in recording:
            print(f"step {terrain.step}: {(terrain.traversability > 0).mean():.0%} traversable")
        for pause in recording.stances():
            print(f"step {pause.step}: {pause.phase.name}, on {', '.join(pause.stance.support_feet)}")
        if recording.scans and recording.calibration is not None:
            scan = recording.scans[0]
            fine = gp.process_scan(scan, recording.calibration, scan.robot, resolution=0.0025, pictures=False)
            print(fine)


if __name__ == "__main__":
    from arguments import call

    call(main)
