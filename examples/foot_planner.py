# /// script
# requires-python = ">=3.11"
# dependencies = ["guara-perception"]
# ///
"""Foot planner: waits for the map of each stance pause and chooses the next foothold of the leg that swings next.

Start a node in one terminal and this in another:

    guara run --simulated
    python examples/foot_planner.py --steps 8
"""

import argparse
import sys

import guara_perception as gp

# Wave gait of the Guará: one leg swings after each pause, the body advances 35 mm, a foot lands 70 mm ahead of its hip.
LIFT_ORDER = ("rh", "rf", "lh", "lf")
HIPS = {"lf": (0.30, 0.18), "rf": (0.30, -0.18), "lh": (-0.30, 0.18), "rh": (-0.30, -0.18)}
ADVANCE, AHEAD_OF_HIP = 0.035, 0.070
SEARCH_RADIUS = 0.060


def choose(terrain: gp.TerrainGrid, leg: str) -> gp.Foothold | None:
    """Best safe foothold near the nominal landing point of the gait; None if there is none."""
    hip_x, hip_y = HIPS[leg]
    return terrain.best_foothold(hip_x + ADVANCE + AHEAD_OF_HIP, hip_y, SEARCH_RADIUS, leg=leg)


def describe(terrain: gp.TerrainGrid, leg: str) -> str:
    """Describe the chosen foothold in one line, or the reasons why there is none."""
    foothold = choose(terrain, leg)
    if foothold is None:
        hip_x, hip_y = HIPS[leg]
        verdict = terrain.check_foothold(hip_x + ADVANCE + AHEAD_OF_HIP, hip_y, leg=leg)
        return f"step {terrain.step}: {leg} stays on the ground: {'; '.join(map(str, verdict.reasons))}"
    return (
        f"step {terrain.step}: {leg} to x {foothold.x:+.3f}, y {foothold.y:+.3f}, z {foothold.z:+.3f} m, "
        f"score {foothold.score:.2f}"
    )


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", help="endpoint of the node")
    parser.add_argument("--robot", default="guara", help="instance name of the robot")
    parser.add_argument("--steps", type=int, default=0, help="number of pauses; 0 = unlimited")
    parser.add_argument("--timeout", type=float, default=60.0, help="seconds to wait for each pause")
    arguments = parser.parse_args()
    try:
        with gp.TerrainClient(arguments.connect, robot=arguments.robot) as client:
            step = 0
            while not arguments.steps or step < arguments.steps:
                # The fused map is needed because hind feet step on ground that was scanned nine cycles ago.
                terrain = client.wait_for_step(step, timeout=arguments.timeout, extent="map")
                print(describe(terrain, LIFT_ORDER[terrain.step % len(LIFT_ORDER)]), flush=True)
                step = terrain.step + 1
    except KeyboardInterrupt:
        return 0
    # Whatever the error (no node, node gone, time-out), the foot stays on the ground.
    except gp.Errors as error:
        print(f"no step without terrain: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
