"""Grids drawn for people with matplotlib, which is loaded when the first picture is drawn: colours, axes, `plot`.

Imports `layers`; `TerrainGrid`, `app` and `view` use it. It writes a file only where it is given a path.
"""
