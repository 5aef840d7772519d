"""Printable calibration targets, to scale: board, crosses, floor mat, labels, ruler.

This package writes one PDF file and nothing else. In `guara_perception`, only the commands and `app.record` import it.
"""
