"""3-D browser view of robot, grids, stripes and footholds.

Imports grids and their `drawing`; only `app` imports it. viser is loaded when a view is opened.
"""
