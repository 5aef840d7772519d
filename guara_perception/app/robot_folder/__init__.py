"""Creation and check of robot folders, for `guara robot new` and `guara robot check`.

Only the commands import this package.
"""
