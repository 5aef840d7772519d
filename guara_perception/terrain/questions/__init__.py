"""What planners ask of a grid: footholds, paths, obstacles, explanations, coarser copies.

Imports `layers` and `assessment`; `TerrainGrid` offers each as a method.
"""
