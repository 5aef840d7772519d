"""Camera interface, and its implementations: V4L2, OpenCV, Aravis and recordings.

Imports the files directly in `drivers`; used by `sweep`, the emulator and `app`.
"""
