"""Makes a robot folder from a URDF, and checks one: `guara robot new` and `guara robot check`.

Only the commands import it.
"""
