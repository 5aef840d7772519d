"""Zenoh sessions, publishers, receivers, queryables and liveliness tokens, for any payload.

Imports `messages`, `security` and some top-level modules of `transport`; used by `grids`, `queries`, other top-level
modules and `guara_perception`.
"""
