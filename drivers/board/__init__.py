"""Laser board over USB: protocol, session, laser and mirror.

Imports the files directly in `drivers`; used by `sweep`, the emulator and `guara_perception.app`.
"""
