"""Readers, writers and converters of scans, sessions, recordings, grids and range images.

This folder imports neither the commands nor the node.
"""
