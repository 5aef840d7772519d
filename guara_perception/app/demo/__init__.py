"""Demos without hardware, checked against the simulated world: a walk from scans to footholds, and a swaying body.

Within the package, only the commands import this folder. The planner of the walk is a separate process, which receives
grids through the public client.
"""
