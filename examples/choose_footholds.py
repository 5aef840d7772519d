"""Footholds near desired positions, the reasons where there is none, and a picture of the footholds.

python examples/choose_footholds.py terrain.npz footholds.png
"""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

import guara_perception as gp

DESIRED = ((0.60, 0.00), (0.70, 0.18), (0.80, -0.05))


def main(grid: str, picture: str) -> None:
    """Find the best foothold within 60 mm of each desired position."""
    terrain = gp.load_terrain(grid)
    chosen = []
    for x, y in DESIRED:
        foothold = terrain.best_foothold(x, y, radius=0.06)
        if foothold is None:
            print(f"({x}, {y}): none: {'; '.join(map(str, terrain.check_foothold(x, y).reasons))}")
            continue
        chosen.append(foothold)
        print(f"({x}, {y}) -> ({foothold.x:.3f}, {foothold.y:.3f}), z {1e3 * foothold.z:.1f} mm, {foothold.score:.2f}")
    figure, axes = plt.subplots(layout="constrained")
    terrain.plot("traversability", footholds=chosen, axes=axes)
    figure.savefig(picture, dpi=120)


if __name__ == "__main__":
    from arguments import call

    call(main)
