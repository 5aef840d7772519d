"""Parts of a grid: geometry, layers, hazards, safety invariant, record, look-up by position.

Every other subpackage of `terrain` may import this one; it imports none of them.
"""
