"""Who may do what: certificates of one's own authority, and the folders and access rules made from them.

Imported by the sessions, by who gives a node its name, and by the commands that make, check and renew such folders.
"""
