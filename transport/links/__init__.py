"""Zenoh sessions, publishers, receivers, queryables and liveliness tokens, for any payload.

Imports `messages`, `security` and the files beside the rooms; the other rooms and the files above them use it.
"""
