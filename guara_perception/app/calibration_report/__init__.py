"""The calibration report: one HTML file with pictures, and a summary for the terminal."""
