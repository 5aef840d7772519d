"""`guara run`: start the node, which scans at each stance pause and publishes until stopped."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from guara_perception.app.exit_codes import EXIT_THREAD_FAILED
from guara_perception.app.logs import STYLES, json_line, log_to_stderr
from guara_perception.app.options import (
    FILE,
    MISTAKES,
    DeviceOptions,
    device_options,
    earlier_option,
    method_options,
    read_node_file,
    refuse_mistakes,
)
from guara_perception.exceptions import FileFormatError, InvalidInput

if TYPE_CHECKING:
    from guara_perception.terrain.grid import TerrainGrid

ROS2_PAIR = "--ros2-tf and --ros2-unknown require --ros2"
SIMULATED_PAIR = "--gait and --world require --simulated; a real robot follows its own gait"

# JPEG frames of this quality take a ninth of the disk space of lossless frames. The compression shifts stripes by
# 0.035 px rms (640 x 512 px, simulated).
JPEG_QUALITY = 90


@click.command(name="run")
@device_options
@click.option(
    "--simulated",
    is_flag=True,
    help="use a simulated robot, world and devices; the robot walks by itself unless --gait is external",
)
@click.option(
    "--gait",
    type=click.Choice(["wave", "external"]),
    default="wave",
    help="with --simulated: external = your own gait announces the stance pauses, and the simulated robot is placed "
    "accordingly",
)
@click.option(
    "--world", default="demo", help="with --simulated: demo, sunlit, stones, or a world file (terrain, light)"
)
@click.option(
    "--record",
    type=FILE,
    help="record every scan to this .mcap file (to w-2.mcap if w.mcap exists), or to files of 1 GB in this folder; "
    'with `record_limit` in node.toml, such as "50GB", the oldest files are removed',
)
@click.option(
    "--ros2",
    is_flag=True,
    help="also publish grids, clouds, markers, camera and status for ROS 2, and receive joint states and IMU",
)
@click.option("--listen", help="endpoint for clients; default: that of the security folder, or tcp/127.0.0.1:7447")
@click.option("--security", type=FILE, help="folder made by `guara security init`")
@click.option("--name", help="instance name in the keys; default: the robot's name")
@partial(method_options, hides_threshold=True)
@click.option(
    "--node",
    type=FILE,
    is_eager=True,
    expose_value=False,
    callback=read_node_file,
    help="node.toml with options of this command (docs/files.md); the command line overrides it",
)
@click.option(
    "--check", is_flag=True, callback=refuse_mistakes, help="only check the configuration; no device is opened"
)
# Hidden options, which are set once for a robot, normally in node.toml.
@click.option("--record-limit", hidden=True, help="total size of the files in the folder; the oldest are removed")
@click.option(
    "--mode",
    type=click.Choice(["adaptive", "standard", "coarse"]),
    default="adaptive",
    hidden=True,
    help="standard: every stripe; coarse: every n-th (robot.toml); adaptive: coarse, then the rest if there are "
    "obstacles",
)
@click.option(
    "--jpeg",
    type=click.IntRange(0, 100),
    default=JPEG_QUALITY,
    hidden=True,
    help="quality of recorded frames; 0: lossless, frames nine times as large",
)
@earlier_option("--lossless", "jpeg", "--jpeg 0", constant=0)
@click.option("--metrics", type=click.IntRange(1, 65535), hidden=True, help="local port for OpenMetrics, such as 9464")
@click.option("--state", type=FILE, hidden=True, help="folder of the journal, for continuing a walk after a restart")
@click.option("--log", type=click.Choice(STYLES), default="text", hidden=True, help="json: a JSON object per line")
@click.option("--ros2-tf", is_flag=True, hidden=True, help="with --ros2: also TF and URDF, below /<robot>")
@click.option(
    "--ros2-unknown",
    type=click.Choice(["100", "-1"]),
    default="100",
    hidden=True,
    help="with --ros2: value of unknown cells in occupancy grids; RViz and Nav2 expect -1",
)
@click.option("--domain", type=click.IntRange(0, 232), default=0, hidden=True, help="ROS 2 domain")
@click.option("--connect", hidden=True, help="use an external Zenoh router instead of being one")
@click.option(
    "--uplink", hidden=True, help="also connect to another router; planner and gait stay connected to this node"
)
@click.option("--allow-insecure", is_flag=True, hidden=True, help="listen beyond this machine without security")
@click.pass_context
def command(
    context: click.Context,
    simulated: bool,
    gait: str,
    world: str,
    record: Path | None,
    record_limit: str | None,
    jpeg: int,
    ros2: bool,
    ros2_tf: bool,
    ros2_unknown: str,
    domain: int,
    listen: str | None,
    connect: str | None,
    uplink: str | None,
    security: Path | None,
    allow_insecure: bool,
    name: str | None,
    mode: str,
    check: bool,
    metrics: int | None,
    state: Path | None,
    log: str,
    method: str,
    threshold: float | None,
    chosen: DeviceOptions,
) -> None:
    """Scan and publish at each stance pause that the gait announces, until Ctrl-C; print one line per scan.

    Camera and trigger are set in devices.toml. Any option can be set in node.toml, including those not listed here:
    size and quality of recordings, routers, ROS 2 domain and TF, a fixed threshold.

    \b
    Example:
      guara run -c calibration.json --record walk.mcap
      guara run -c calibration.json --record recordings --record-limit 50GB
      guara run --simulated
      guara run --simulated --gait external --world terrain.toml
      guara run --node node.toml
      guara run --node node.toml --check
    """
    from importlib.metadata import version

    from guara_perception.app.files.recording_files import read_limit
    from guara_perception.app.metrics import metrics_served
    from guara_perception.app.node.claim import Seal
    from guara_perception.app.node.configuration import ConfigurationWatch, mistakes_of
    from guara_perception.app.node.devices import choose_rig
    from guara_perception.app.node.journal import Journal
    from guara_perception.app.node.node import PerceptionNode
    from guara_perception.app.node.node_status import NodeStatus, certificates_item
    from guara_perception.app.node.pause_scanner import PauseScanner
    from guara_perception.app.node.recorder import ScanRecorder
    from guara_perception.app.scene.live import SceneMirror
    from guara_perception.app.scene.scene import Scene
    from guara_perception.app.service import service_manager
    from guara_perception.app.until_stopped import closed_within, stop_event
    from guara_perception.scanning.stripe_finder import check_method
    from guara_perception.stripes.kernel.library import kernel
    from transport.keys import DEFAULT_ROBOT, check_name, stance_key
    from transport.links.session import check_node_links
    from transport.node_name import open_only_node
    from transport.ros2_stream import Ros2Stream
    from transport.server import PerceptionServer
    from transport.stance_link import StanceReceiver
    from transport.stance_stream_link import StanceStreamReceiver
    from transport.supervision import Failure, follow, forget

    if all(context.get_parameter_source(name) is ParameterSource.COMMANDLINE for name in ("jpeg", "earlier_lossless")):
        raise InvalidInput("--lossless and --jpeg are mutually exclusive: give one of them")
    # Report a damaged installation now, not at the first scan.
    kernel()
    log_to_stderr(log)
    report = click.echo if log == "text" else _report_as_json
    options: list[Callable[[], object]] = [
        partial(check_method, method, threshold),
        partial(_check_pairs, not ros2 and (ros2_tf or ros2_unknown != "100"), ROS2_PAIR),
        partial(_check_pairs, not simulated and (gait != "wave" or world != "demo"), SIMULATED_PAIR),
        partial(check_name, DEFAULT_ROBOT if name is None else name),
        partial(check_node_links, listen, connect, uplink, security, allow_insecure),
    ]
    if record_limit is not None:
        options.append(partial(read_limit, record_limit, record))
    if check:
        mistakes = mistakes_of(chosen, simulated=simulated, security=security, world=world, options=options)
        if found := [*context.meta.get(MISTAKES, []), *mistakes]:
            raise FileFormatError(*found)
        click.echo("the configuration is sound; no device was opened")
        return
    for option in options:
        option()
    limit = None if record_limit is None else read_limit(record_limit, record)
    quality = jpeg or None
    final: list[Failure] = []
    with ExitStack() as stack:
        stop = stack.enter_context(stop_event())

        def end_with(failure: Failure) -> None:
            if failure.is_final:
                final.append(failure)
                stop.set()

        follow(end_with)
        stack.callback(forget, end_with)
        rig = choose_rig(chosen, simulated=simulated, on_the_move=True, world=world)
        instance = rig.robot.name if name is None else name
        stack.enter_context(closed_within(rig.rangefinder))
        session = stack.enter_context(
            open_only_node(
                robot=instance,
                listen=listen,
                connect=connect,
                uplink=uplink,
                security=security,
                allow_insecure=allow_insecure,
                is_stopped=stop.is_set,
            )
        )
        status = NodeStatus(rig.calibration)
        status.on_scan = partial(_report_scan, report)
        watch = ConfigurationWatch(chosen.calibration, chosen.devices, rig.robot.folder)
        status.follow(watch.item)
        if security is not None:
            status.follow(lambda: certificates_item(security))
        server = PerceptionServer(
            session, robot=instance, collect_status=status.items, ros2_domain=domain if ros2 else None
        )
        # The server must close before the session, so that images being drawn for ROS 2 are still sent.
        stack.callback(server.close)
        scene = Scene(rig.robot, rig.calibration)
        mirror = SceneMirror(server, scene, unknown=int(ros2_unknown), with_tf=ros2_tf) if ros2 else None
        recorder = journal = None
        if record is not None:
            recorder = stack.enter_context(
                ScanRecorder(
                    record, robot=instance, calibration=rig.calibration, jpeg_quality=quality, scene=scene, limit=limit
                )
            )
        if state is not None:
            seal = Seal.of(instance, rig.robot, rig.calibration)
            journal = stack.enter_context(Journal(state, rig.robot, seal))
        scanner = PauseScanner(
            *(rig.robot, rig.calibration, rig.rangefinder, server),
            method=method,
            threshold=threshold,
            recorder=recorder,
            status=status,
            mirror=mirror,
            journal=journal,
        )
        node = stack.enter_context(PerceptionNode(scanner, mode))
        if metrics is not None:
            stack.enter_context(metrics_served(metrics, instance, server.status_items))
        on_pause = node.on_pause
        if gait == "external" and rig.simulation is not None:
            from guara_perception.app.node.simulated_gaits import ExternalGait

            on_pause = ExternalGait(rig.simulation, node, report).on_pause
        StanceReceiver(session, robot=instance, on_pause=on_pause, on_refused=node.on_refused)
        StanceStreamReceiver(session, robot=instance, on_batch=node.on_stream, on_refused=node.on_stream_refused)
        if ros2:
            standing = rig.robot.state(rig.robot.posture(rig.robot.config.scan_posture))
            frame = rig.robot.config.imu_frame
            Ros2Stream(
                session,
                node.on_stream,
                node.on_stream_refused,
                robot=instance,
                domain=domain,
                joints=rig.robot.tree.joint_names,
                legs=rig.robot.legs,
                rotation_imu_to_base=None if frame is None else standing.transform_to_base(frame)[:3, :3],
            )
        report(f"{instance}: listening on {', '.join(session.endpoints)}; press Ctrl-C to stop")
        if uplink is not None:
            report(f"{instance}: uplink to {uplink}; reconnects after a loss")
        report(f"guara-perception {version('guara-perception')}")
        if recorder is not None:
            report(f"recording to {recorder.path}: {recording_size(quality)}")
            if cut := recorder.cut:
                report(f"incomplete files: {len(cut)}; `guara convert {cut[-1]} NEW.mcap` makes the newest readable")
        stack.enter_context(service_manager(node.is_well))
        if gait == "external":
            report(f"{instance}: waiting for your gait to announce stance pauses on {stance_key(instance)}")
        elif rig.simulation is not None:
            from guara_perception.app.node.simulated_gaits import walk_until_stopped

            walk_until_stopped(rig.simulation, node, session, instance, stop, report)
        stop.wait()
    report("stopped, laser off")
    if final:
        click.echo(f"guara: {final[0]}", err=True)
        click.get_current_context().exit(EXIT_THREAD_FAILED)


def _check_pairs(is_wrong: bool, text: str) -> None:
    """Refuse options that only work with another one.

    Raises:
        InvalidInput: `is_wrong` is True; the message is `text`.
    """
    if is_wrong:
        raise InvalidInput(text)


def _report_as_json(text: str) -> None:
    click.echo(json_line("INFO", __name__, text))


def _report_scan(report: Callable[[str], None], terrain: TerrainGrid) -> None:
    """Report a scan in one line, also to the service manager. A closed pipe (`| head`) does not stop the node."""
    from guara_perception.app.service import notify
    from guara_perception.app.summary import summary

    line = summary(terrain)
    notify(f"STATUS={line}")
    with suppress(OSError):
        report(line)


def recording_size(quality: int | None) -> str:
    """Format of recorded frames, and the approximate size of one hour of recording."""
    rate = "at 640 x 512 px and a pause every 4 s"
    if quality is None:
        return f"lossless frames, about 35 GB an hour {rate}; as JPEG (--jpeg {JPEG_QUALITY}) about 5 GB"
    if quality > JPEG_QUALITY:
        return f"JPEG frames of quality {quality}, more than 5 GB an hour {rate}"
    return f"JPEG frames of quality {quality}, at most about 5 GB an hour {rate}; with --jpeg 0 about 35 GB"
