"""Ranging: from stripe positions to points in the robot's frame, and on to the surface and the range images.

Imports `stripes`, `calibration` and `terrain.assessment`; `scanning`, `simulation` and `app` use it. It performs
no I/O.
"""
