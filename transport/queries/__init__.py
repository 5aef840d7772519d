"""Questions over Zenoh and their answers: grids, scans, status, the clock of another machine.

Imports `links`, `messages` and the files beside the rooms; `grids`, client and server use it.
"""
