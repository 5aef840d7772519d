"""Scans with board and camera, each stripe verified against the commands; metering of exposure and camera lag.

Imports `board`, `cameras` and the files directly in `drivers`; used by `app`.
"""
