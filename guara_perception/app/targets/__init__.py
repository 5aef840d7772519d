"""Printable calibration targets, to scale: checkerboard, crosses, floor mat, labels, ruler.

This package writes one PDF file and nothing else. Only `app` imports it.
"""
