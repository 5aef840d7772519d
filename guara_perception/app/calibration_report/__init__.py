"""Calibration report: an HTML file with figures, and a summary for the terminal.

Only the commands and `acceptance` import it; everything in it is derived from the CalibrationResult.
"""
