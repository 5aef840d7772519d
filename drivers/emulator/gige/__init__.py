"""A GigE Vision camera that is not there: Aravis' fake one in a process of its own, with pictures of the caller's.

Real packets on loopback; `FakeGigeCamera.expose` is its trigger line. Needs Aravis.
"""

from __future__ import annotations

from drivers.emulator.gige.fake import FakeGigeCamera, FakeState

__all__ = ["FakeGigeCamera", "FakeState"]
