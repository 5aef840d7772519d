"""Exit codes of the `guara` command; 0 is success."""

from __future__ import annotations

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
# A thread of the node failed too often to be restarted again (`transport.supervision`).
EXIT_THREAD_FAILED = 3
# The calibration of `guara run` belongs to another camera or, with --simulated, to another robot, so a restart does not
# help.
EXIT_CALIBRATION = 4
# Code that shells report for a program ended by Ctrl-C.
EXIT_INTERRUPTED = 130
