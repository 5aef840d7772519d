"""Creation of a robot folder from a URDF, and its check: `guara robot new` and `guara robot check`.

Only the commands import it.
"""
