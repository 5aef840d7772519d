"""Terrain: elevation grids with hazards, queries of planners, and the map of a walk.

Subpackages: `layers`, `assessment`, `questions`, `map`, `scan`, `drawing`. Here: TerrainGrid, its file, `compare`.
`scanning`, `app`, `view` and `simulation` may import it. The only files that it reads and writes are grids and maps.
"""
