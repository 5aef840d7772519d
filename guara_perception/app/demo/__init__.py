"""`guara demo`: the main job with no hardware, checked against the known world."""
