"""Queries over Zenoh and their servers: grids, scans, status, and the clock of another process.

Imports `links`, `messages` and modules of `transport` itself; used by `grids` and other modules of `transport` itself.
"""
