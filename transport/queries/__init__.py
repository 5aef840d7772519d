"""Queries over Zenoh and their servers: grids, scans, status, and the clock of another machine.

Imports `links`, `messages` and modules of `transport` itself; used by `grids`, client and server.
"""
