"""Options of a scan by an emulated camera."""

from drivers import (
    AcquireOptions,
    OffFrames,
)

ALL_MODES = list(OffFrames)


def options(off: OffFrames, **more: object) -> AcquireOptions:
    return AcquireOptions(off=off, frame_timeout=20.0, **more)
