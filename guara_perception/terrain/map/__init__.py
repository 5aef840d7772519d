"""The map of a walk: looks of several pauses fused in `odom`, snapshots, known ground.

Imports `layers`, `assessment` and `TerrainGrid`; `app` and `simulation` use it.
"""
