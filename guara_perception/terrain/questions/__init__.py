"""Queries of planners: footholds, paths, obstacles, regions, stairs, explanations; other forms and files of grids.

Imports `layers` and `assessment`; `TerrainGrid` offers each query as a method.
"""
