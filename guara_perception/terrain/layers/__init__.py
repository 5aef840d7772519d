"""Parts of a grid: geometry, polygons, layers, hazards, safety invariant, look-up by position.

Every other subpackage of `terrain` may import this one; it imports none of them.
"""
