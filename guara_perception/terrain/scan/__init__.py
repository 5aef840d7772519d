"""When and how to scan, and grids from arrays that no stripe made.

Imports the other rooms of `terrain`; `app` and users call it.
"""
