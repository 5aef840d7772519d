"""Terrain: elevation grids with hazards, queries for planners, and the map of a walk.

Subpackages: `layers`, `assessment`, `questions`, `map`, `scan`, `drawing`. Modules: `grid` (TerrainGrid), `file`,
`compare`. `ranging`, `scanning`, `app`, `view` and `simulation` import it. It reads and writes files of grids and maps,
and writes figures.
"""
