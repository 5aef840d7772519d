"""When and how to scan, and grids from arrays that no stripe made.

Imports the other subpackages of `terrain`; `app` and users call it.
"""
