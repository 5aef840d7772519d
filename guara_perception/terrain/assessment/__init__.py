"""From samples to hazards: raster, windows, slope, step, roughness, edges and causes of the unknown.

Imports `layers` only; the scan processor, `scan` and `map` use it.
"""
