"""From samples to hazards: raster, slope, step, roughness, edges, and causes of unknown cells.

Imports `layers` only; the scan processor, `scan` and `map` use it.
"""
