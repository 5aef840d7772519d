"""Publishing of grids, waiting for grids, and the decision whether a received grid may be used.

Imports `links`, `queries`, `messages` and the files above these folders; used by client and server.
"""
