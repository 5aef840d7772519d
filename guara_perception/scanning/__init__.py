"""Scanning: from the frames of one scan, added while they arrive, to a terrain grid.

Imports `stripes`, `calibration`, `ranging` and `terrain`; `app` uses it. It does no input or output, except that
`ScanProcessor` loads a calibration given by its path, and a robot given by its name or folder.
"""
