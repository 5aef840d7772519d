"""`guara demo`: a walk from scans to footholds without hardware, checked against the known world.

Only the commands of `app` import it; its planner is a process of its own that uses nothing but the public client.
"""
