"""Ranging: from stripe positions to points in the robot's frame, to surface and to range images.

Imports `stripes`, `calibration` and the grids' `layers` and `assessment`; the scan processor, `simulation` and `app`
use it. It does no input or output.
"""
