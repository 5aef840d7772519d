"""Every example of README and docs is run as a reader would, in a folder that holds the recorded data.

`sh` blocks run line by line, `python` blocks as scripts, all blocks of a page in order in one folder. The folder
holds `calibration.json` and links: `scans/paper`, `scans/dark`, `scans/tilt`, `session`, `tests/data`, `my_robot.urdf`.
A block that talks to the default endpoint gets a node that publishes the paper scan, unless the
page started one itself (`guara run --simulated`, stopped at the end of the page). What cannot be run here is checked
as far as it goes: `make` lines against the Makefile, `guara demo` lines (it has tests of its own) and blocks after a
line `<!-- needs: laser board and camera -->` by parsing their options and importing what they import. Blocks that begin
with `# not run here: ` also name what is missing for the reader; their `guara` lines are parsed.
"""

import ast
import fcntl
import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
import textwrap
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import click
import pytest

import guara_perception as gp
from guara_perception.app.main import guara as program

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
LANGUAGES = ("sh", "python", "text", "json", "toml")
HARDWARE = "laser board and camera"
NOT_RUN = "# not run here: "
ENDPOINT = ("127.0.0.1", 7447)
# Commands that run until they are stopped.
ENDLESS = re.compile(r"guara (run\b|view\b|listen\b(?!.*--count))")
PATIENCE = 120.0
NODE = """
import sys, time
from dataclasses import replace
import guara_perception as gp
from guara_perception.app.publisher import send_terrain
from transport import open_node
from transport.server import PerceptionServer

with open_node() as session:
    server = PerceptionServer(session)
    send_terrain(server, replace(gp.load_terrain(sys.argv[1]), stamp=time.time_ns(), step=12))
    server.flush(30)
    print("ready", flush=True)
    sys.stdin.read()
"""


@dataclass(frozen=True)
class Block:
    """One fenced example: where it stands, its language, its text, and what it needs."""

    source: str
    language: str
    text: str
    needs: str


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page, in order."""
    found = []
    fenced = r"(?:^<!-- needs: (?P<needs>.*?) -->\n+)?^(?P<indent> *)```(?P<language>[^\n]*)\n(?P<text>.*?)^ *```[ ]*$"
    for match in re.finditer(fenced, page.read_text(), re.MULTILINE | re.DOTALL):
        line = page.read_text()[: match.start("language")].count("\n") + 1
        text = textwrap.dedent(match["text"])
        found.append(Block(f"{page.relative_to(ROOT)}:{line}", match["language"].strip(), text, match["needs"] or ""))
    return found


class Reader:
    """Types what a page says, in one folder, and stops what runs on."""

    def __init__(self, folder: Path, terrain: Path) -> None:
        self.folder = folder
        self.terrain = terrain
        self.running: list[tuple[str, subprocess.Popen]] = []
        self.node: subprocess.Popen | None = None
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        self.turn: TextIO | None = None
        self.environment = {**os.environ, "PATH": path, "MPLBACKEND": "Agg", "PYTHONUNBUFFERED": "1"}

    def start(self, command: list[str]) -> subprocess.Popen:
        return subprocess.Popen(
            command,
            cwd=self.folder,
            env=self.environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def read(self, block: Block) -> None:
        """Do what one block says."""
        if block.language == "json":
            json.loads(block.text)
        elif block.language == "toml":
            tomllib.loads(block.text)
        elif block.language == "python":
            self.python(block)
        elif block.language == "sh":
            for line in block.text.replace("\\\n", " ").splitlines():
                if line.strip() and not line.lstrip().startswith("#"):
                    self.shell(block, line.split("  #")[0].strip())

    def python(self, block: Block) -> None:
        if block.needs == HARDWARE:
            imports = [n for n in ast.parse(block.text).body if isinstance(n, ast.Import | ast.ImportFrom)]
            exec(compile(ast.Module(imports, []), block.source, "exec"), {})
            return
        if f"{ENDPOINT[0]}:{ENDPOINT[1]}" in block.text:
            self.provide_node()
        script = self.folder / "example.py"
        script.write_text(block.text)
        self.finish(block, ["python", "-W", "error::DeprecationWarning", script.name])
        script.unlink()

    def shell(self, block: Block, line: str) -> None:
        if block.text.startswith(NOT_RUN):
            if line.startswith("guara "):
                parse_only(line)
        elif line.startswith("make "):
            check_make(line)
        elif block.needs == HARDWARE or line.startswith("guara demo"):
            parse_only(line)
        elif ENDLESS.match(line.removeprefix(".venv/bin/")):
            self.start_endless(block, line)
        else:
            if "guara listen" in line:
                self.provide_node()
            self.finish(block, ["bash", "-euo", "pipefail", "-c", line.replace(".venv/bin/", "")])

    def finish(self, block: Block, command: list[str]) -> None:
        process = self.start(command)
        try:
            output, _ = process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            raise AssertionError(f"{block.source}: does not end: {command[-1]}") from None
        assert process.returncode == 0, f"{block.source}: {command[-1]}\nexit {process.returncode}\n{output}"

    def start_endless(self, block: Block, line: str) -> None:
        """Start it and wait for its port or first line; only a node goes on running, for what follows on the page."""
        is_node = "guara run" in line
        if is_node:
            self.stop_node()
            self.take_port()
        elif "guara listen" in line:
            self.provide_node()
        process = self.start(["bash", "-c", f"exec {line.replace('.venv/bin/', '')}"])
        self.running.append((f"{block.source}: {line}", process))
        if is_node:
            wait_for_port(free=False)
        else:
            assert process.stdout.readline(), f"{block.source}: {line}: ended without output"
            self.stop_running()

    def provide_node(self) -> None:
        """Somebody must publish at the default endpoint."""
        if self.node is None and not self.running:
            self.take_port()
            self.node = self.start(["python", "-c", NODE, str(self.terrain)])
            said = self.node.stdout.readline()
            assert said == "ready\n", f"the example node did not start: {said}{self.node.stdout.read()}"

    def take_port(self) -> None:
        """Wait until no other test of this machine, and nobody else, has the default port; it is ours until `leave`."""
        if self.turn is None:
            self.turn = (Path(tempfile.gettempdir()) / f"guara-test-port-{ENDPOINT[1]}.lock").open("w")
            fcntl.flock(self.turn, fcntl.LOCK_EX)
        wait_for_port(free=True)

    def leave(self) -> None:
        """End what is left, and give the port back."""
        for process in (self.node, *(process for _, process in self.running)):
            if process is not None and process.poll() is None:
                process.kill()
                process.communicate()
        if self.turn is not None:
            self.turn.close()

    def stop_node(self) -> None:
        if self.node is not None:
            self.node.communicate("", timeout=PATIENCE)
            self.node = None

    def stop_running(self) -> None:
        """Press Ctrl-C on all that runs; each must end cleanly."""
        running, self.running = self.running, []
        for name, process in running:
            process.send_signal(signal.SIGINT)
            try:
                output, _ = process.communicate(timeout=PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                raise AssertionError(f"{name}: does not end at Ctrl-C") from None
            assert process.returncode == 0 and "Traceback" not in output, f"{name}\nexit {process.returncode}\n{output}"


def wait_for_port(*, free: bool) -> None:
    """Wait until the default port is free, or answers."""
    deadline = time.monotonic() + PATIENCE
    while True:
        with socket.socket() as probe:
            is_free = probe.connect_ex(ENDPOINT) != 0
        if is_free == free:
            return
        if time.monotonic() > deadline:
            raise AssertionError(f"port {ENDPOINT[1]} is {'taken by another program' if free else 'not opened'}")
        time.sleep(0.1)


def check_make(line: str) -> None:
    """Every target that is named stands in the Makefile."""
    targets = [word for word in shlex.split(line)[1:] if "=" not in word and not word.startswith("-")]
    rules = (ROOT / "Makefile").read_text()
    for target in targets:
        assert re.search(rf"^{re.escape(target)}:", rules, re.MULTILINE), f"make has no target {target}"


def parse_only(line: str) -> None:
    """The options of a `guara` line are those that the command has."""
    arguments = shlex.split(line.removeprefix(".venv/bin/"))
    assert arguments[0] == "guara", f"only guara lines can be checked without hardware: {line}"
    command = program.get_command(click.Context(program), arguments[1])
    assert command is not None, f"no such command: {line}"
    command.make_context(arguments[1], arguments[2:])


@pytest.fixture
def reader(tmp_path: Path, data: Path, calibration_file: Path, paper_terrain: gp.TerrainGrid) -> Iterator[Reader]:
    """A reader in a folder with the data."""
    (tmp_path / "scans").mkdir()
    for name in ("paper", "dark", "tilt"):
        (tmp_path / "scans" / name).symlink_to(data / "scans" / name)
    (tmp_path / "session").symlink_to(data / "calibration")
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "data").symlink_to(data)
    (tmp_path / "my_robot.urdf").symlink_to(ROOT / "tests" / "robots" / "tapir" / "urdf" / "tapir.urdf")
    (tmp_path / "calibration.json").write_text(calibration_file.read_text())
    paper_terrain.save(tmp_path / ".published.npz")
    page_reader = Reader(tmp_path, tmp_path / ".published.npz")
    yield page_reader
    page_reader.leave()


@pytest.mark.heavy
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_examples_of_a_page_work(page: Path, reader: Reader):
    """Each example runs without an error, in the order of the page; what runs on ends cleanly at Ctrl-C."""
    for block in blocks(page):
        reader.read(block)
    reader.stop_running()
    reader.stop_node()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_block_says_what_it_is(page: Path):
    """Each fenced block names a language that this test knows, and what it needs is known."""
    for block in blocks(page):
        assert block.language in LANGUAGES, f"{block.source}: {block.language!r} is none of {LANGUAGES}"
        assert block.needs in ("", HARDWARE), f"{block.source}: needs {block.needs!r}"
    assert len(re.findall(r"^ *```", page.read_text(), re.MULTILINE)) == 2 * len(blocks(page))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path):
    """Every relative link of a page is a file of the checkout, every `#anchor` a heading of its page."""
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        linked = (page.parent / file).resolve() if file else page
        assert linked.exists(), f"{page.name}: {target}"
        if anchor:
            headings = re.findall(r"^#+ (.*)$", linked.read_text(), re.MULTILINE)
            anchors = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
            assert anchor in anchors, f"{page.name}: {target}"


def test_the_storages_of_a_router_are_read_by_zenoh(tmp_path: Path):
    """The section of `zenohd`'s configuration on the page goes into one that we write, and Zenoh takes both as one."""
    from transport import zenoh_api
    from transport.security.router_folder import make_router

    (section,) = [block for block in blocks(ROOT / "docs" / "several-robots.md") if block.language == "json"]
    made = make_router(tmp_path / "keys", ["rex"]) / "zenoh.json5"
    whole = json.dumps({**json.loads(made.read_text()), **json.loads(section.text)})
    assert zenoh_api.configuration_value(whole, "plugins/storage_manager/storages/maps/volume/id") == "rocksdb"
    assert zenoh_api.configuration_value(whole, "access_control/enabled") is True


@pytest.mark.slow
def test_a_broken_example_is_noticed(reader: Reader, tmp_path: Path):
    """The reader does fail: on an error, on an unknown target, on an unknown option."""
    with pytest.raises(AssertionError, match="exit 1"):
        reader.read(Block("here", "python", "raise SystemExit(1)", ""))
    with pytest.raises(AssertionError, match="exit 2"):
        reader.read(Block("here", "sh", "guara process scans/none -c calibration.json -o a.npz", ""))
    with pytest.raises(AssertionError, match="no target nonsense"):
        reader.read(Block("here", "sh", "make nonsense", ""))
    with pytest.raises(click.NoSuchOption):
        reader.read(Block("here", "sh", "guara listen --nonsense", HARDWARE))
    with pytest.raises(ImportError):
        reader.read(Block("here", "python", "from guara_perception import nonsense", HARDWARE))
