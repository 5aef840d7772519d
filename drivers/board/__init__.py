"""The laser board over USB: its protocol, the session with it, laser and mirror.

Imports the files beside the rooms of `drivers`; `sweep`, the emulator and `app` use it.
"""
