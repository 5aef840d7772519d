"""An emulated GigE Vision camera: Aravis' fake camera in a process of its own, with pictures that the caller supplies.

Real packets on loopback; `FakeGigeCamera.expose` is its trigger line. Needs Aravis.
"""

from __future__ import annotations

from testbed.gige.fake import FakeGigeCamera, FakeState

__all__ = ["FakeGigeCamera", "FakeState"]
