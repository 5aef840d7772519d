"""Queries for planners (footholds, paths, obstacles, regions, stairs), and conversion and saving of grids.

Imports `layers` and `assessment`; `TerrainGrid` offers each query as a method.
"""
