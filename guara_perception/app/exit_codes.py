"""Exit codes of the `guara` command; 0 is success."""

from __future__ import annotations

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
# A thread of the node failed and was restarted too often (`transport.supervision`).
EXIT_THREAD_FAILED = 3
# `guara run` with a calibration that is refused, or does not fit robot or camera: a restart does not mend it.
EXIT_CALIBRATION = 4
# As shells report a program that Ctrl-C ended.
EXIT_INTERRUPTED = 130
