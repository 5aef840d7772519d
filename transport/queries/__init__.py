"""Queries over Zenoh and their servers: grids, scans, status, and the clock of another machine.

Imports `links`, `messages` and the files above these folders; used by `grids`, client and server.
"""
