"""Exit codes of the `guara` command; 0 is success."""

from __future__ import annotations

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
# A thread of the node failed and was restarted too often (`transport.supervision`).
EXIT_THREAD_FAILED = 3
# `guara run` with a calibration that is refused, or is of another robot or camera: a restart does not help.
EXIT_CALIBRATION = 4
# As shells report a program ended by Ctrl-C.
EXIT_INTERRUPTED = 130
