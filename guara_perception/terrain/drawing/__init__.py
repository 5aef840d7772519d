"""Plots of grids with matplotlib, which is loaded when the first plot is drawn: colours, axes, `plot`.

Imports `layers`; `TerrainGrid`, `app` and `view` use it. It writes a file only if it is given a path.
"""
