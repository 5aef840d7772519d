"""Calibration report: an HTML file with figures, and a summary for the terminal.

Only the commands and `acceptance` import this folder. All contents of the report come from the CalibrationResult.
"""
