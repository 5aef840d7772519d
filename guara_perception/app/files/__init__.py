"""Scans, sessions and range images in folders and recordings: opened, written, converted.

Most of `app` imports it; it imports neither the commands nor the node.
"""
