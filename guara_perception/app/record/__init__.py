"""From devices to a calibration session: what is asked of a person, step by step, and what is kept.

Only the commands import it; it uses the node's rangefinder, the calibration and, for `--simulated`, the simulation.
"""
