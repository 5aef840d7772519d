"""Commands, node, client, opening and saving: everything of perception that touches the outside world.

Rooms: `commands`, `node`, `files`, `figures`, `targets`, `calibration_report`, `demo`; here what several of them use.
It imports every other folder; none of them imports it.
"""
