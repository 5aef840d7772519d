"""The view in the browser: grids, stripes and footholds on the robot, in three dimensions.

Imports grids and their `drawing`; only `app` imports it. viser is loaded when a view is opened.
"""
