"""Plots of grids with matplotlib: colours, axes, `plot`.

Matplotlib is loaded when the first plot is drawn. Of `terrain`, the package imports `layers` only; `TerrainGrid`, `app`
and `view` use it. Only `save_figure` writes a file.
"""
