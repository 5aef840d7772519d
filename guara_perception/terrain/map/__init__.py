"""Map of a walk: fusion of the scans of several pauses in `odom`, drift correction, snapshots, known ground.

Imports `layers`, `assessment` and `TerrainGrid`; `terrain.scan`, `app` and `simulation` use it.
"""
