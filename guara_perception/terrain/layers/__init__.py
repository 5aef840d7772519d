"""What a grid consists of: geometry, polygons over it, layers, hazards, the invariant and look-ups by position.

Every other subpackage of `terrain` may import this one; it imports none of them.
"""
