"""Grids as they are published, waited for and judged: which may be used, by what was heard of their node.

Imports `links`, `queries`, `messages` and the files beside the rooms; client and server use it.
"""
