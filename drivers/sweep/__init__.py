"""Scans with board and camera, in which each stripe is verified; metering of exposure and camera lag.

Imports `board`, `cameras` and the files directly in `drivers`; used by `app`.
"""
