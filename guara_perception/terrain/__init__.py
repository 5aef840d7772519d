"""Terrain: elevation grids with hazards, what can be asked of them, and the map of a walk.

Subpackages: `layers`, `assessment`, `questions`, `map`, `scan`; here `grid` (TerrainGrid) and its `file`.
The processor, `app`, `view` and `simulation` may import it; it does no input or output but its own file.
"""
