"""Scans, sessions and range images in folders and recordings: opened, written, converted.

The commands and the node import it; it imports neither.
"""
