"""The calibration report: one HTML file with pictures, and a summary for the terminal.

Only the commands of `app` import it; it computes nothing that is not in the CalibrationResult.
"""
