"""Demo without hardware: a walk from scans to footholds, checked against the simulated world.

Within the package, only the commands import this folder. The planner is a separate process, which receives grids
through the public client.
"""
