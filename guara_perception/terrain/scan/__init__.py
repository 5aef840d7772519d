"""Scan policy, and grids from the data of other sensors.

Imports the other subpackages of `terrain`; `app` and users call it.
"""
