"""Certificates of a private authority, and the security folders and access rules made from them.

Imported by the sessions, by `node_name`, and by the commands that make, check and renew such folders.
"""
