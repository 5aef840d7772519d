"""Certificates of a private authority, and security folders and access rules based on them.

Imported by the sessions, by `node_name`, and by programs that make, check and renew such folders.
"""
