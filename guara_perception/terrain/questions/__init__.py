"""Queries of planners: footholds, paths, obstacles, explanations, coarser grids.

Imports `layers` and `assessment`; `TerrainGrid` offers each as a method.
"""
