"""Scene of a recording for the Rerun viewer: imported data, clouds and markers in their colours, and a blueprint."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from guara_perception.app.scene.scene import cloud_field, cloud_points
from guara_perception.arrays import Float
from guara_perception.exceptions import FileFormatError, InvalidInput, ViewerFailed, errors_as, optional_library
from guara_perception.files import check_target, existing_file, whole_file
from kinematics import ODOM
from transport import TerrainMessage, TransportError
from transport.recording import Recording, open_recording

APPLICATION = "guara_perception"
TIMELINE = "message_log_time"
PURPOSE = "the scene in Rerun"
# Radii of points and lines [m].
CELL_RADIUS, STRIPE_RADIUS, LINE_RADIUS = 0.0025, 0.0008, 0.0015
STRIPE_COLOUR, REGION_COLOUR = (213, 94, 0), (0, 89, 61)
# Eye and target of the view relative to the robot, seen from its front right [m].
VIEWPOINT, LOOKED_AT = (1.45, -1.05, 0.70), (0.35, 0.0, 0.05)
BACKGROUND = (38, 42, 48)
LINE_LIST = 5


def open_in_rerun(path: Path) -> None:
    """Show a recording in the Rerun viewer; return when the viewer is closed.

    Raises:
        ViewerFailed: the viewer failed, for instance without a display.
        MissingExtra, MissingFile, FileFormatError, InvalidInput: as in `save_rerun_scene`.
    """
    with tempfile.TemporaryDirectory(prefix="guara-rerun-") as folder:
        scene = save_rerun_scene(path, Path(folder) / f"{path.stem}.rrd")
        code = subprocess.run(
            # The viewer accepts connections from this machine only.
            [sys.executable, "-m", "rerun", str(scene), "--bind", "127.0.0.1", "--port", "auto"],
            check=False,
        ).returncode
    if code:
        raise ViewerFailed(
            f"the Rerun viewer ended with code {code}; without a display, --save {path.stem}.rrd writes a file "
            "that `rerun` opens elsewhere"
        )


def save_rerun_scene(path: Path, out: Path) -> Path:
    """Write a recording as an .rrd file that opens as one scene, blueprint included; return `out`.

    Raises:
        MissingExtra: rerun-sdk is not installed.
        MissingFile: the recording or the folder of `out` does not exist.
        FileFormatError: the file is not a recording, or is truncated or damaged.
        InvalidInput: the recording has no scene, `path` is not an .mcap file, or `out` is a folder or lacks the
            ending .rrd.
    """
    rerun = optional_library("rerun", "rerun", PURPOSE)
    check_target(out, ".rrd")
    existing_file(path)
    if path.suffix != ".mcap":
        raise InvalidInput(f"{path}: Rerun shows recordings (.mcap); `guara view {path}` shows grids and scans")
    with (
        errors_as(FileFormatError, "", TransportError),
        open_recording(path) as recording,
        whole_file(out) as temporary,
    ):
        last = _last_map(recording)
        robot, position, model = last.robot, _position_of(last), _model_of(_description_of(recording))
        stream = rerun.RecordingStream(APPLICATION, recording_id=path.stem)
        stream.save(str(temporary), default_blueprint=blueprint(robot, model, position))
        stream.log_file_from_path(str(path))
        for entity, shape in solid_shapes(_description_of(recording)):
            stream.log(entity, shape, static=True)
        for time, entity, what in _drawn(recording, robot):
            stream.set_time(TIMELINE, timestamp=np.datetime64(time, "ns"))
            stream.log(entity, *what)
        stream.flush()
        stream.disconnect()
    return out


def blueprint(robot: str, model: str, position: Float) -> Any:
    """Layout of the viewer: robot and terrain in odom, with the camera images beside them; it follows the newest data.

    Args:
        robot: instance name.
        model: name of the robot in its URDF.
        position: (3,) position of the robot in odom at the end [m], at which the viewer looks.
    """
    rrb: Any = optional_library("rerun.blueprint", "rerun", PURPOSE)
    kinds = rrb.archetypes
    # Clouds and markers are drawn in their colours below `scene`; flat grids would cover them.
    hidden = [f"/{robot}/{topic}/**" for topic in ("map", "scan", "occupancy", "grid_map", "camera/on", "camera/off")]
    hidden.append(f"/{model}/collision_geometries/**")
    space = rrb.Spatial3DView(
        name="Robot and terrain",
        origin="/",
        contents=["+ /**", *(f"- {entity}" for entity in hidden)],
        spatial_information=kinds.SpatialInformation(target_frame=ODOM),
        background=BACKGROUND,
        eye_controls=kinds.EyeControls3D(
            position=position + VIEWPOINT, look_target=position + LOOKED_AT, eye_up=(0.0, 0.0, 1.0)
        ),
    )
    pictures = [
        rrb.Spatial2DView(name=f"Camera, laser {kind}", origin=f"/{robot}/camera/{kind}") for kind in ("on", "off")
    ]
    return rrb.Blueprint(
        rrb.Horizontal(space, rrb.Vertical(*pictures), column_shares=[3, 1]),
        rrb.TimePanel(timeline=TIMELINE, play_state="following"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _last_map(recording: Recording) -> TerrainMessage:
    newest = deque(recording.terrains("map"), maxlen=1)
    if not newest or next(recording.written("map/points"), None) is None:
        raise InvalidInput(
            f"{recording.path} contains no scene: it has no map, or was recorded by an earlier version; "
            f"`guara view {recording.path}` shows what is in it"
        )
    return newest[0]


def _description_of(recording: Recording) -> str:
    """URDF in a recording, empty if it has none."""
    return next((str(message.data) for message in recording.messages("/robot_description")), "")


def _model_of(description: str) -> str:
    """Name of the robot in its URDF, under which Rerun's importer stores the robot's shapes."""
    found = re.search(r"<robot[^>]*\bname\s*=\s*[\"']([^\"']+)", description)
    return found[1] if found else ""


def solid_shapes(description: str) -> Iterator[tuple[str, Any]]:
    """Yield the entity of each primitive visual of a URDF, and a component that makes it solid.

    The importer alone does not draw these visuals as solids.
    """
    rerun: Any = optional_library("rerun", "rerun", PURPOSE)
    shapes = {"box": rerun.Boxes3D, "cylinder": rerun.Cylinders3D, "sphere": rerun.Ellipsoids3D}
    try:
        root = ElementTree.fromstring(description)
    except ElementTree.ParseError:
        return
    for link in root.findall("link"):
        for number, geometry in enumerate(link.findall("visual/geometry")):
            kind = next((shapes[found.tag] for found in geometry if found.tag in shapes), None)
            if kind is not None:
                entity = f"/{root.get('name')}/visual_geometries/{link.get('name')}/visual_{number}"
                yield entity, kind.from_fields(fill_mode="solid")


def _position_of(message: TerrainMessage) -> Float:
    """Position (3,) of the robot in odom at the scan of a map [m]; the origin if that is unknown."""
    to_odom = [item.matrix[:3, 3] for item in message.transforms if item.destination_frame == ODOM]
    return np.asarray(to_odom[0] if to_odom else np.zeros(3))


def _drawn(recording: Recording, robot: str) -> Iterator[tuple[int, str, tuple[Any, ...]]]:
    """Yield time [ns], entity and components of data that the importer draws in the wrong colours or not at all."""
    rerun: Any = optional_library("rerun", "rerun", PURPOSE)

    def frame(message: Any) -> Any:
        return rerun.CoordinateFrame(message.header.frame_id)

    for time, cloud in recording.written("map/points"):
        points, rgb = cloud_points(cloud), cloud_field(cloud, "rgb")
        colours = np.column_stack([rgb >> shift & 0xFF for shift in (16, 8, 0)]).astype(np.uint8)
        terrain = rerun.Points3D(points, colors=colours, radii=CELL_RADIUS)
        yield time, f"/{robot}/scene/terrain", (terrain, frame(cloud))
    for time, cloud in recording.written("scan/points"):
        stripes = rerun.Points3D(cloud_points(cloud), colors=STRIPE_COLOUR, radii=STRIPE_RADIUS)
        yield time, f"/{robot}/scene/stripes", (stripes, frame(cloud))
    for time, array in recording.written("markers"):
        header = array.markers[0]
        for name, colour in (("obstacles", STRIPE_COLOUR), ("regions", REGION_COLOUR)):
            edges = [marker for marker in array.markers if marker.type == LINE_LIST and marker.ns == name]
            strips = [np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 2, 3) for marker in edges]
            lines = rerun.LineStrips3D(np.concatenate([np.zeros((0, 2, 3)), *strips]), colors=colour, radii=LINE_RADIUS)
            yield time, f"/{robot}/scene/{name}", (lines, frame(header))
        soles = [marker for marker in array.markers if marker.ns == "footholds"]
        boxes = rerun.Boxes3D(
            centers=[(m.pose.position.x, m.pose.position.y, m.pose.position.z) for m in soles],
            sizes=[(m.scale.x, m.scale.y, m.scale.z) for m in soles],
            colors=(0, 114, 178),
            fill_mode="solid",
        )
        yield time, f"/{robot}/scene/footholds", (boxes, frame(header))
