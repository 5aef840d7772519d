"""Zenoh sessions, publishers, receivers, queryables and liveliness tokens, for any payload.

Imports `messages`, `security` and modules directly in `transport`; used by `grids`, `queries`, those modules and
`guara_perception`.
"""
