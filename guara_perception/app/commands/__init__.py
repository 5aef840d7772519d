"""Subcommands of `guara`. Each module has a click command named `command`.

`app.main` imports a module when its command is called, and a command imports most of what it needs when it runs, so
that help pages are fast. No other module of the package imports the commands.
"""
