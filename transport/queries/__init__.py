"""Queries over Zenoh and their servers: grids, scans, status, and the clock of another process.

Imports `links`, `messages` and top-level modules of `transport`; used by `grids`, other top-level modules and the
perception node.
"""
