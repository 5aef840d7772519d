"""Map of a walk: fusion of the scans of several pauses in `odom`, drift correction, snapshots, known ground.

Within `terrain`, this package imports only `layers`, `assessment` and `TerrainGrid`; `terrain.scan`, `app` and
`simulation` use it.
"""
