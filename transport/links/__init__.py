"""A session of Zenoh and what goes over it, whatever it carries: publishers, receivers, tokens, what was missed.

Imports `messages`, `security` and the files beside the rooms; the other rooms and the files above them use it.
"""
