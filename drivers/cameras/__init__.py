"""Camera interface, and its implementations: V4L2, OpenCV, Aravis and recordings.

Imports the files beside the rooms of `drivers`; `sweep`, the emulator and `app` use it.
"""
