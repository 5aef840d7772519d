"""Queries of planners: footholds, paths, obstacles, regions, stairs, explanations, coarser grids.

Imports `layers` and `assessment`; `TerrainGrid` offers each query as a method.
"""
