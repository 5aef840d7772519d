"""Emulated GigE Vision camera: the fake camera of Aravis in a separate process, with images supplied by the caller.

It sends real packets on loopback, and is triggered by `FakeGigeCamera.expose`. Needs Aravis.
"""

from __future__ import annotations

from testbed.gige.fake import FakeGigeCamera, FakeState

__all__ = ["FakeGigeCamera", "FakeState"]
