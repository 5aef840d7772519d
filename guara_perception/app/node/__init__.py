"""The node: from a stance pause to published terrain, with real devices or simulated ones.

Commands, demo, `record` and `acceptance` import it; it writes recordings and reads no scans.
"""
