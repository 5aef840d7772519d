"""Zenoh sessions, publishers, receivers, queryables and liveliness tokens, for any payload.

Imports `messages`, `security` and the files above these folders; used by the other folders.
"""
