"""Printable calibration targets, to scale: checkerboard, crosses, floor mat, labels, ruler.

Only `app` imports it; it writes one PDF and nothing else.
"""
