"""Recording of a calibration session: tasks for the operator, and the session folder that results.

Only the commands import it; it uses the node's rangefinder, the calibration and, for `--simulated`, the simulation.
"""
