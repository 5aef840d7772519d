"""Subcommands of `guara`. Each module has a click command named `command`.

`app.main` imports a module when its command is called, and a command imports most of what it needs when it runs, so
that help pages are fast. Outside this folder, only `app.main` imports the commands.
"""
