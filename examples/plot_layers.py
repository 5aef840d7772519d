"""Layers of a grid as pictures.

python examples/plot_layers.py terrain.npz layers.png
"""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

import guara_perception as gp


def main(grid: str, picture: str) -> None:
    """Draw heights, slope, steps and hazards side by side."""
    terrain = gp.load_terrain(grid)
    figure, axes = plt.subplots(2, 2, figsize=(11, 8), layout="constrained")
    for panel, layer in zip(axes.flat, ("elevation", "slope", "step_height", "hazard"), strict=True):
        terrain.plot(layer, axes=panel, hazards=False)
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    from arguments import call

    call(main)
