"""Commands, node, client and files: all of perception that does I/O.

Its folders: `commands`, `node`, `files`, `figures`, `scene`, `demo`, `record`, `calibration_report`, `targets`,
`robot_folder`; modules beside them are used by several of them. `app` imports from every other folder of
`guara_perception`; none of those imports from `app`.
"""
