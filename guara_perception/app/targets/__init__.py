"""Printable calibration targets, to scale: board, crosses, floor mat, labels, ruler.

This package writes one PDF file and nothing else. Only `app` imports it.
"""
