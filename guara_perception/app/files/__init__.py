"""Readers, writers and converters of scans, sessions and range images, in folders and recordings.

Most of `app` imports this folder, which imports neither the commands nor the node.
"""
