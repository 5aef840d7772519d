"""The node: from a stance pause to published terrain, with real devices or simulated ones.

The commands and the demo import it; it writes recordings and reads no scans.
"""
