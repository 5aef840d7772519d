"""Publishing of grids, waiting for grids, and acceptance of received grids.

Imports `links`, `queries`, `messages` and the files above these folders; used by client, server and fleet.
"""
