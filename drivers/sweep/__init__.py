"""A scan with board and camera: stripes in firing order, each proved to be in step; exposure and lag measured.

Imports `board`, `cameras` and the files beside the rooms of `drivers`; `app` uses it.
"""
