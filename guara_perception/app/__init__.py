"""Application layer of perception: commands, node, client, devices, files and reports.

The folders are `commands`, `node`, `files`, `figures`, `scene`, `demo`, `record`, `calibration_report`, `targets` and
`robot_folder`. `app` may import from every other folder of `guara_perception`, and none of those imports from `app`.
"""
