"""Cameras: what every one must do, and those there are, from V4L2 and OpenCV to Aravis and recordings.

Imports the files beside the rooms of `drivers`; `sweep`, the emulator and `app` use it.
"""
