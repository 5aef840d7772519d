"""GenICam description of the fake camera, based on the registers of Aravis' fake camera.

Its input Line1 is mapped to the software trigger of Aravis' fake camera, so that the process can trigger it.
"""

from __future__ import annotations

from collections.abc import Mapping

# Registers of Aravis' fake camera (its src/arvfakecamera.h).
WIDTH, HEIGHT, GAIN, GAIN_AUTO = 0x100, 0x104, 0x110, 0x114
SENSOR_HEIGHT, SENSOR_WIDTH, EXPOSURE, ACQUISITION, PIXEL_FORMAT = 0x118, 0x11C, 0x120, 0x124, 0x128
ACQUISITION_MODE, OFFSET_X, OFFSET_Y, FRAME_PERIOD = 0x12C, 0x130, 0x134, 0x138
TRIGGER_MODE, TRIGGER_SOURCE, TRIGGER_ACTIVATION, TRIGGER_NOW = 0x300, 0x304, 0x308, 0x30C
# Registers that Aravis' fake camera does not use, for settings that it does not emulate.
EXPOSURE_AUTO, LINE_SELECTOR, LINE_MODE, LINE_SOURCE = 0x400, 0x404, 0x408, 0x40C
FORMATS = {
    "Mono8": 0x01080001,
    "BayerGR8": 0x01080008,
    "BayerRG8": 0x01080009,
    "BayerGB8": 0x0108000A,
    "BayerBG8": 0x0108000B,
}
LINE1 = 1
FRAME_RATES = (1, 500)
AUTOMATICS = {"Off": 1, "Continuous": 2}


def description() -> str:
    """Return the GenICam XML of the camera."""
    strings = {"DeviceVendorName": (0x48, 32), "DeviceModelName": (0x68, 32), "DeviceID": (0xD8, 16)}
    whole = [
        *[_string(name, *registers) for name, registers in strings.items()],
        _integer("SensorWidth", SENSOR_WIDTH, "RO"),
        _integer("SensorHeight", SENSOR_HEIGHT, "RO"),
        _integer("Width", WIDTH, highest="SensorWidth"),
        _integer("Height", HEIGHT, highest="SensorHeight"),
        _integer("OffsetX", OFFSET_X, highest="SensorWidth", lowest=0),
        _integer("OffsetY", OFFSET_Y, highest="SensorHeight", lowest=0),
        _choice("PixelFormat", PIXEL_FORMAT, FORMATS),
        _choice("AcquisitionMode", ACQUISITION_MODE, {"Continuous": 1, "SingleFrame": 2, "MultiFrame": 3}),
        _command("AcquisitionStart", ACQUISITION, 1),
        _command("AcquisitionStop", ACQUISITION, 0),
        _converted("AcquisitionFrameRate", FRAME_PERIOD, "1000000 / X", *FRAME_RATES),
        _converted("ExposureTime", EXPOSURE, "X", 10, 1_000_000),
        _choice("ExposureAuto", EXPOSURE_AUTO, AUTOMATICS),
        _converted("Gain", GAIN, "X", 0, 24),
        _choice("GainAuto", GAIN_AUTO, AUTOMATICS),
        _choice("TriggerSelector", None, {"FrameStart": 0}),
        _choice("TriggerMode", TRIGGER_MODE, {"Off": 0, "On": 1}),
        _choice("TriggerSource", TRIGGER_SOURCE, {"Line0": 0, "Line1": LINE1}),
        _choice("TriggerActivation", TRIGGER_ACTIVATION, {"RisingEdge": 0}),
        _choice("LineSelector", LINE_SELECTOR, {"Line1": 0, "Line2": 1}),
        _choice("LineMode", LINE_MODE, {"Input": 0, "Output": 1}),
        _choice("LineSource", LINE_SOURCE, {"Off": 0, "ExposureActive": 1}),
        '<IntSwissKnife Name="PayloadSize"><pVariable Name="W">Width</pVariable><pVariable Name="H">Height</pVariable>'
        "<Formula>W * H</Formula></IntSwissKnife>",
        '<Integer Name="TLParamsLocked"><Value>0</Value><Min>0</Min><Max>1</Max></Integer>',
        '<Port Name="Device"/>',
    ]
    head = (
        '<?xml version="1.0" encoding="utf-8"?>\n<RegisterDescription ModelName="Fake" VendorName="Guara" '
        'StandardNameSpace="None" SchemaMajorVersion="1" SchemaMinorVersion="0" SchemaSubMinorVersion="1" '
        'MajorVersion="1" MinorVersion="0" SubMinorVersion="0" ToolTip="Fake camera" ProductGuid="0" VersionGuid="0" '
        'xmlns="http://www.genicam.org/GenApi/Version_1_0">\n'
    )
    return "\n".join([head, '<Category Name="Root"/>', *whole, "</RegisterDescription>\n"])


def _register(name: str, address: int, access: str = "RW") -> str:
    return (
        f'<IntReg Name="{name}"><Address>{address:#x}</Address><Length>4</Length><AccessMode>{access}</AccessMode>'
        "<pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
    )


def _string(name: str, address: int, length: int) -> str:
    return (
        f'<StringReg Name="{name}"><Address>{address:#x}</Address><Length>{length}</Length>'
        "<AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>"
    )


def _integer(name: str, address: int, access: str = "RW", highest: str | None = None, lowest: int = 1) -> str:
    bounds = "" if highest is None else f"<Min>{lowest}</Min><pMax>{highest}</pMax><Inc>1</Inc>"
    inner = f'<Integer Name="{name}"><pValue>{name}Register</pValue>{bounds}</Integer>'
    return inner + _register(f"{name}Register", address, access)


def _choice(name: str, address: int | None, entries: Mapping[str, int]) -> str:
    inner = "".join(f'<EnumEntry Name="{entry}"><Value>{value}</Value></EnumEntry>' for entry, value in entries.items())
    text = f'<Enumeration Name="{name}">{inner}<pValue>{name}Register</pValue></Enumeration>'
    if address is None:
        return text + f'<Integer Name="{name}Register"><Value>0</Value></Integer>'
    return text + _register(f"{name}Register", address)


def _command(name: str, address: int, value: int) -> str:
    return (
        f'<Command Name="{name}"><pValue>{name}Register</pValue><CommandValue>{value}</CommandValue></Command>'
        + _register(f"{name}Register", address, "WO")
    )


def _converted(name: str, address: int, formula: str, lowest: float, highest: float) -> str:
    """Return the XML of a float that is converted to a register by `formula`, which must be its own inverse."""
    there, back = formula.replace("X", "FROM"), formula.replace("X", "TO")
    return (
        f'<Float Name="{name}"><pValue>{name}Converter</pValue><Min>{lowest}</Min><Max>{highest}</Max></Float>'
        f'<Converter Name="{name}Converter"><FormulaTo>{there}</FormulaTo><FormulaFrom>{back}</FormulaFrom>'
        f"<pValue>{name}Register</pValue></Converter>" + _register(f"{name}Register", address)
    )
