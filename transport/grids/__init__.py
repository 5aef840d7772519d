"""Publishing of grids, waiting for grids, and acceptance of received grids.

Imports `links`, `queries`, `messages` and modules directly in `transport`; used by the modules `client`, `server`
and `fleet` there, and by `guara_perception`.
"""
