# /// script
# requires-python = ">=3.11"
# dependencies = ["guara-perception"]
# ///
"""A foot planner: waits for the terrain of every stance pause and picks the next foothold of the leg whose turn it is.

Start a node in one terminal and this in another:

    guara run --simulated
    python examples/foot_planner.py --steps 8
"""

import argparse
import sys

import guara_perception as gp

# The Guará's wave gait: one leg swings after every pause, the body advances 35 mm, a foot lands 70 mm before its hip.
LIFT_ORDER = ("rh", "rf", "lh", "lf")
HIPS = {"lf": (0.30, 0.18), "rf": (0.30, -0.18), "lh": (-0.30, 0.18), "rh": (-0.30, -0.18)}
ADVANCE, AHEAD_OF_HIP = 0.035, 0.070
SEARCH_RADIUS = 0.060


def choose(terrain: gp.TerrainGrid, leg: str) -> gp.Foothold | None:
    """The best safe place for a foot near where the gait would set it; None when there is none."""
    hip_x, hip_y = HIPS[leg]
    return terrain.best_foothold(hip_x + ADVANCE + AHEAD_OF_HIP, hip_y, SEARCH_RADIUS, leg=leg)


def describe(terrain: gp.TerrainGrid, leg: str) -> str:
    """One line about the choice, or about why there is none."""
    foothold = choose(terrain, leg)
    if foothold is None:
        hip_x, hip_y = HIPS[leg]
        verdict = terrain.check_foothold(hip_x + ADVANCE + AHEAD_OF_HIP, hip_y, leg=leg)
        return f"step {terrain.step}: {leg} stays where it is: {'; '.join(map(str, verdict.reasons))}"
    return (
        f"step {terrain.step}: {leg} to x {foothold.x:+.3f}, y {foothold.y:+.3f}, z {foothold.z:+.3f} m, "
        f"score {foothold.score:.2f}"
    )


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", help="where the node listens")
    parser.add_argument("--robot", default="guara", help="instance name of the robot")
    parser.add_argument("--steps", type=int, default=0, help="number of pauses after which to end; 0 = never")
    parser.add_argument("--timeout", type=float, default=60.0, help="seconds to wait for each pause")
    arguments = parser.parse_args()
    try:
        with gp.TerrainClient(arguments.connect, robot=arguments.robot) as client:
            step = 0
            while not arguments.steps or step < arguments.steps:
                # The fused map: a hind foot treads on what was scanned nine cycles ago.
                terrain = client.wait_for_step(step, timeout=arguments.timeout, extent="map")
                print(describe(terrain, LIFT_ORDER[terrain.step % len(LIFT_ORDER)]), flush=True)
                step = terrain.step + 1
    except KeyboardInterrupt:
        return 0
    # Every error of waiting (nobody there, gone, nothing in time) means the same for a foot: it stays on the ground.
    except gp.Errors as error:
        print(f"no terrain, no step: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
