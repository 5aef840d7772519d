"""Who may do what: certificates of one's own authority, and the folders and access rules made from them.

Imported by the sessions, by `node_name`, and by the commands that make, check and renew such folders.
"""
