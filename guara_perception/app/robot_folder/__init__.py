"""Creation and check of robot folders, for `guara robot new` and `guara robot check`.

In `guara_perception`, only the commands import this package.
"""
