"""Recording of a calibration session: tasks for the operator, and the session folder that results.

Only the commands and `import_pictures` import it; it uses the node's rangefinder, the calibration and, for
`--simulated`, the simulation.
"""
