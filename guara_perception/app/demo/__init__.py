"""Demo without hardware: a walk from scans to footholds, checked against the simulated world.

Only the commands of `app` import this folder. The planner is a separate process that uses only the public client.
"""
