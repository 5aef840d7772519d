"""Zenoh sessions, publishers, receivers, queryables and liveliness tokens, whatever they carry.

Imports `messages`, `security` and the files beside the rooms; the other rooms and the files above them use it.
"""
