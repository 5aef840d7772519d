"""Camera interface, and its implementations: V4L2, OpenCV, Aravis and replay of existing frames.

Imports the files directly in `drivers`; used by `sweep`, the emulator, and `app` and `simulation` of
`guara_perception`.
"""
