"""Scan policy, and grids from the data of other sensors.

Imports `layers`, `assessment`, `map` and `TerrainGrid`; `app` and users call it.
"""
