"""Recording of a calibration session: tasks for the operator, and the resulting session folder.

This package uses the node's rangefinder, the calibration and, for `--simulated`, the simulation. Only the commands and
`import_pictures` import it.
"""
