"""Map of a walk: scans of several pauses fused in `odom`, snapshots, known ground.

Imports `layers`, `assessment` and `TerrainGrid`; `app` and `simulation` use it.
"""
