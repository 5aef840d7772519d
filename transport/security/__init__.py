"""Certificates of a private authority, and security folders and access rules based on them.

Imported by `links.session`, `node_name`, `security_check`, and programs that make, check and renew such folders.
"""
