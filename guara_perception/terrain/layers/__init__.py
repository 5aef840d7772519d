"""What a grid consists of: geometry, layers, hazards, the invariant and the look-ups by position.

Every other room of `terrain` may import this one; it imports none of them.
"""
