"""One module per subcommand of `guara`; each holds a click command named `command`.

`app.main` imports a command when it is called, a command what it needs when it runs: help pages stay quick. Nobody else
imports them.
"""
