"""Commands, node, client, opening and saving: everything of perception that touches the outside world.

Rooms: `commands`, `node`, `files`, `figures`, `demo`, `record`, `calibration_report`, `targets`, `robot_folder`; here
what several of them use. It imports every other folder; none of them imports it.
"""
