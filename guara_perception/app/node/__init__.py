"""Perception node: from a stance pause to published terrain, with real or simulated devices.

Commands, demo, `record` and `acceptance` import this folder. The node writes recordings, but reads no recorded scans.
"""
