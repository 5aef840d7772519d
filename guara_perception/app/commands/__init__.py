"""One module per subcommand of `guara`; each holds a click command named `command`."""
