"""From samples to hazards: raster, slope, step, roughness, edges, and causes of unknown cells.

Of `terrain`, it imports `layers` only. `ranging`, `scanning` and, in `terrain`, `scan`, `map` and `questions` use it.
"""
