"""Terrain: elevation grids with hazards, queries of planners, and the map of a walk.

Subpackages: `layers`, `assessment`, `questions`, `map`, `scan`, `drawing`. Modules: `grid` (TerrainGrid), `file`,
`compare`. `scanning`, `app`, `view` and `simulation` may import it. It reads and writes only files of grids and maps.
"""
