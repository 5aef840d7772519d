"""The cameras that Aravis finds on networks and buses."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.cameras.aravis_library import glib_error, load_aravis
from drivers.errors import CameraNotFound


@dataclass(frozen=True, slots=True)
class AravisDevice:
    """A camera that Aravis found.

    Attributes:
        name: name by which `AravisCamera` opens it.
        maker, model, serial: what the camera reports of itself.
        address: its address on the network or the bus.
        protocol: "GigEVision", "USB3Vision" or "Fake".
    """

    name: str
    maker: str
    model: str
    serial: str
    address: str
    protocol: str


def find_aravis_cameras() -> tuple[AravisDevice, ...]:
    """Look for cameras on all networks and buses; takes about a second.

    Raises:
        CameraBackendMissing: Aravis is not installed.
    """
    aravis = load_aravis()
    aravis.update_device_list()
    return tuple(
        AravisDevice(
            name=aravis.get_device_id(number),
            maker=aravis.get_device_vendor(number) or "",
            model=aravis.get_device_model(number) or "",
            serial=aravis.get_device_serial_nbr(number) or "",
            address=aravis.get_device_address(number) or "",
            protocol=aravis.get_device_protocol(number) or "",
        )
        for number in range(aravis.get_n_devices())
    )


def trigger_lines(name: str) -> tuple[str, ...]:
    """Ask a camera on which of its lines it can be triggered.

    Args:
        name: name of the camera, as `find_aravis_cameras` gives it.

    Raises:
        CameraBackendMissing: Aravis is not installed.
        CameraNotFound: it does not answer, or another program holds it.
    """
    aravis = load_aravis()
    try:
        sources = aravis.Camera.new(name).dup_available_trigger_sources()
    except glib_error() as error:
        raise CameraNotFound(f"it does not answer ({error}): does another program hold it?") from None
    return tuple(source for source in sources if source.startswith("Line"))
