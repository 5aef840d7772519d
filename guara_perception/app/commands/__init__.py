"""One module per subcommand of `guara`; each holds a click command named `command`.

`app.main` imports a command when it is called, and a command imports what it needs when it runs, so that help pages
stay quick. No other module imports them.
"""
