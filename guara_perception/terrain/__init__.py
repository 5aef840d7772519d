"""Terrain: from points to grids, hazards and answers for planners."""
