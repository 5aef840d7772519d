"""From devices to a calibration session: what a person is asked to do, task by task, and what is kept.

Only the commands import it; it uses the node's rangefinder, the calibration and, for `--simulated`, the simulation.
"""
