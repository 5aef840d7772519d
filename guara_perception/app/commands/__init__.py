"""Subcommands of `guara`: one module each, with a click command named `command`.

`app.main` imports a module when its command is called, and a command imports what it needs when it runs, so that help
pages are fast. No other module imports the commands.
"""
