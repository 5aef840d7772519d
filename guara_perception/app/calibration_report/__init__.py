"""Calibration report: an HTML file with figures, and a summary for the terminal.

Only the commands of `app` import it; it computes nothing that is not in the CalibrationResult.
"""
