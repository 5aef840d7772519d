"""Ranging: from stripe positions to points in the robot's frame, and to the surface between stripes.

Imports `stripes`, `calibration` and `terrain.assessment`; `scanning`, `simulation` and `app` use it. It performs
no I/O.
"""
