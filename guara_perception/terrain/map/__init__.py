"""Map of a walk: fusion of the scans of several pauses in `odom`, drift correction, snapshots, known ground.

Of `terrain`, it imports `layers`, `assessment` and `TerrainGrid`. `terrain.scan`, `app` and `simulation` use it.
"""
