"""Commands, node, client, opening and saving: everything of perception that touches the outside world."""
