"""Scans with board and camera, in which each stripe is verified; exposure metering and measurement of camera lag.

Imports `board`, `cameras` and the files directly in `drivers`; used by `guara_perception.app`.
"""
