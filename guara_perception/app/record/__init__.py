"""Recording of a calibration session: tasks for the operator, and the resulting session folder.

Only the commands and `import_pictures` import this folder, which uses the node's rangefinder, the calibration and, for
`--simulated`, the simulation.
"""
