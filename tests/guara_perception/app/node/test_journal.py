"""Journal of a walk: a restarted node continues from it if everything fits; otherwise a new walk begins."""

from __future__ import annotations

import dataclasses
import stat
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.node.claim import FORMAT, Claim, Seal
from guara_perception.app.node.journal import Journal
from guara_perception.app.node.walk_map import WalkMap
from guara_perception.arrays import Float
from guara_perception.exceptions import FileFormatError, InvalidInput
from guara_perception.fields import parse_json
from guara_perception.ground_picture import GroundPicture
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.gait import WaveGait
from guara_perception.simulation.walk import WalkPause, simulate_walk
from kinematics import RobotModel, Stance, load_robot
from tests.guara_perception.app.node.live_bench import wait_until
from transport import Health

pytestmark = pytest.mark.slow

OLD = Path(__file__).parents[3] / "data" / "journal"
# Times of the scans [s].
BEGUN, PERIOD = 1000.0, 10.0
LAST = 3
LEGS = "lf", "lh", "rf", "rh"


@dataclasses.dataclass(frozen=True)
class Scanned:
    """Pause with its scan."""

    pause: WalkPause
    stance: Stance
    wide: gp.TerrainGrid
    picture: GroundPicture | str

    @property
    def step(self) -> int:
        return self.wide.step

    @property
    def standing(self) -> dict[str, int]:
        """Number of pauses through which each foot has stood, regardless of what happened to the robot."""
        order = WaveGait.of(load_robot("guara")).lift_order
        return {leg: min((self.pause.step - 1 - n) % 4, self.pause.step) for n, leg in enumerate(order)}

    def fuse(self, walk_map: WalkMap, **changes: object) -> gp.TerrainGrid:
        given = {
            "epoch": "w",
            "standing_pauses": self.standing,
            "picture": self.picture,
            "terrain": self.wide,
        } | changes
        given = {"stance": self.stance, "time": BEGUN + PERIOD * self.step, "step": self.step} | given
        return walk_map.update(known_ground=self.pause.known_ground, **given)


@pytest.fixture(scope="module")
def calibration(robot: RobotModel) -> gp.Calibration:
    return specimen(robot, (640, 512), 1)


@pytest.fixture(scope="module")
def scan(robot: RobotModel, calibration: gp.Calibration) -> Callable[..., Scanned]:
    """Scan a pause, also of a robot that was moved by a transform (4, 4) in the world."""
    rangefinder = SimulatedRangefinder(World(seed=1), calibration, robot, 1)

    def scan(
        pause: WalkPause,
        moved: Float | None = None,
        stance: Stance | None = None,
        step: int = -1,
        stripes: range = range(0, 70, 2),
    ) -> Scanned:
        pose = pause.transform_base_to_world if moved is None else moved @ pause.transform_base_to_world
        rangefinder.set_pose(pose, pause.joint_positions)
        stance, step = stance or pause.stance, pause.step if step < 0 else step
        processor = gp.ScanProcessor(calibration, robot, stance, "coarse", step=step)
        for index, on, off in rangefinder.frames(stripes):
            processor.add(index, on, off)
        return Scanned(pause, stance, processor.finish("wide"), processor.ground_picture)

    return scan


@pytest.fixture(scope="module")
def walk(scan: Callable[..., Scanned], robot: RobotModel) -> list[Scanned]:
    """Pauses 0 to 4 of a walk on level ground."""
    return [scan(pause) for pause in simulate_walk(World(seed=1), robot, cycles=(LAST + 1) / 4, seed=1)]


@pytest.fixture
def seal(robot: RobotModel, calibration: gp.Calibration) -> Seal:
    return Seal.of("guara", robot, calibration)


@pytest.fixture
def opened(tmp_path: Path, robot: RobotModel, calibration: gp.Calibration, seal: Seal) -> Callable[..., tuple]:
    """Journal in `tmp_path`, and the map of a node that was started with it."""

    def opened(**changes: str) -> tuple[Journal, WalkMap]:
        journal = Journal(tmp_path / "state", robot, dataclasses.replace(seal, **changes))
        return journal, WalkMap(robot, calibration, journal)

    return opened


@pytest.fixture
def killed(walk: list[Scanned], opened: Callable[..., tuple], monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Journals of a node killed after pause 3, the older first; a confirmed pause is in one of them at once."""
    monkeypatch.setattr("guara_perception.app.node.journal.CONFIRM_S", 60.0)
    journal, walk_map = opened()
    with journal:
        for scanned in walk[: LAST + 1]:
            scanned.fuse(walk_map)
            walk_map.keep()
            journal.write(walk_map.claim(BEGUN + PERIOD * scanned.step))
            journal.confirm()
            assert journal.item().values["step"] == str(scanned.step)
            assert wait_until(partial(is_copied, journal, scanned.step))
    return sorted(path_of(journal).glob("*.journal"), key=lambda path: path.stat().st_mtime_ns)


def path_of(journal: Journal) -> Path:
    return journal._paths[0].parent


def is_copied(journal: Journal, step: int) -> bool:
    """True if two files contain a pause."""
    heads = [path.read_bytes().split(b"\n", 2)[1] for path in path_of(journal).glob("guara-*.journal")]
    return [parse_json(head, "journal").integer("step") for head in heads].count(step) == 2


def same(one: gp.TerrainGrid, other: gp.TerrainGrid) -> bool:
    """True if all layers are equal, except the bounds of unknown ground, which no file stores."""
    layers = set(one.layers) - {"ceiling"}
    return all(np.array_equal(one.layer(name), other.layer(name), equal_nan=True) for name in layers)


@pytest.fixture(scope="module")
def uninterrupted(walk: list[Scanned], robot: RobotModel, calibration: gp.Calibration) -> gp.TerrainGrid:
    """Map of pause 4 of a node that was not restarted."""
    walk_map = WalkMap(robot, calibration)
    return [scanned.fuse(walk_map) for scanned in walk][-1]


@pytest.fixture(scope="module")
def fresh(walk: list[Scanned], robot: RobotModel, calibration: gp.Calibration) -> gp.TerrainGrid:
    """Map of pause 4 of a node that starts there."""
    return walk[-1].fuse(WalkMap(robot, calibration))


def test_a_restarted_node_goes_on_as_if_it_had_not_been(
    walk: list[Scanned], killed: list[Path], opened: Callable[..., tuple], uninterrupted: gp.TerrainGrid
) -> None:
    """The map of the next pause equals that of an uninterrupted node, bit for bit; only the user can read the files."""
    journal, walk_map = opened()
    assert "continues if the next pause fits" in journal.item().message
    assert same(walk[-1].fuse(walk_map), uninterrupted)
    item = journal.item()
    assert (item.level, item.message) == (Health.OK, "walk 'w' continues from step 3")
    assert item.values["resumed"] == "1"
    assert [stat.S_IMODE(path.stat().st_mode) for path in killed] == [0o600] * 3
    assert stat.S_IMODE(killed[0].parent.stat().st_mode) == 0o700


def test_a_copy_stands_in_for_a_journal_that_was_cut(
    walk: list[Scanned], killed: list[Path], opened: Callable[..., tuple], uninterrupted: gp.TerrainGrid
) -> None:
    """Nothing is lost if one file is truncated, whichever it is and wherever it ends."""
    content = killed[2].read_bytes()
    for number, length in enumerate((0, 5, 79, 4000, len(content) // 2, len(content) - 1)):
        damaged = killed[1 + number % 2]
        damaged.write_bytes(content[:length])
        journal, _ = opened()
        assert [claim.step for claim in journal.claims] == [LAST, LAST - 1]
        assert str(damaged) in journal.item().message
        damaged.write_bytes(content)
    killed[2].write_bytes(b"")
    _, walk_map = opened()
    assert same(walk[-1].fuse(walk_map), uninterrupted)


def test_the_journal_before_stands_in_for_one_that_was_cut_with_its_copy(
    walk: list[Scanned], killed: list[Path], opened: Callable[..., tuple], uninterrupted: gp.TerrainGrid
) -> None:
    """Two swings have passed since then; all ground of the walk is kept."""
    for path in killed[1:]:
        path.write_bytes(path.read_bytes()[:4000])
    journal, walk_map = opened()
    assert [claim.step for claim in journal.claims] == [LAST - 1]
    fused = walk[-1].fuse(walk_map)
    assert journal.item().message == "walk 'w' continues from step 2"
    known, then = (np.isfinite(each.elevation) for each in (fused, uninterrupted))
    assert known.sum() > 0.99 * then.sum()


def test_a_scan_that_was_cut_short_judges_no_journal(
    walk: list[Scanned],
    killed: list[Path],
    opened: Callable[..., tuple],
    scan: Callable[..., Scanned],
    robot: RobotModel,
    calibration: gp.Calibration,
    uninterrupted: gp.TerrainGrid,
) -> None:
    """Only its own ground is published, and the journal is kept for the next scan."""
    for path in killed[1:]:
        path.unlink()
    cut = scan(walk[LAST].pause, stripes=range(0, 40, 2))
    journal, walk_map = opened()
    with journal:
        fused = cut.fuse(walk_map)
        assert same(fused, cut.fuse(WalkMap(robot, calibration)))
        assert any(
            "cut short; the next scan decides whether the journal fits" in why
            for why in fused.metadata["health"]["reasons"]
        )
        walk_map.keep()
        # It must not replace the pending journal.
        assert walk_map.claim(BEGUN) is None
        following = walk[-1].fuse(walk_map)
    assert journal.item().message == "walk 'w' continues from step 2"
    known, then = (np.isfinite(each.elevation) for each in (following, uninterrupted))
    assert known.sum() > 0.99 * then.sum()
    assert following.metadata["restarts"] == []


def test_after_a_scan_that_was_cut_short_a_carried_robot_is_refused(
    walk: list[Scanned],
    killed: list[Path],
    opened: Callable[..., tuple],
    scan: Callable[..., Scanned],
    robot: RobotModel,
    calibration: gp.Calibration,
) -> None:
    """The complete scan decides; the walk and its journal then continue from the short one."""
    pauses = [walk[LAST].pause, walk[-1].pause]
    moved = [aside(0.0, 0.02), aside(0.0, 0.02)]
    cut, whole = (
        scan(pause, motion, stripes=range(0, n, 2)) for pause, motion, n in zip(pauses, moved, (40, 70), strict=True)
    )
    for path in killed[1:]:
        path.unlink()
    journal, walk_map = opened()
    alone = WalkMap(robot, calibration)
    assert same(cut.fuse(walk_map), cut.fuse(alone))
    walk_map.keep()
    alone.keep()
    assert same(whole.fuse(walk_map), whole.fuse(alone))
    assert journal.item().values["refused"] == "1"
    assert walk_map.claim(BEGUN) is not None


def test_that_a_walk_goes_on_is_logged(
    walk: list[Scanned], killed: list[Path], opened: Callable[..., tuple], caplog: pytest.LogCaptureFixture
) -> None:
    """The event is logged even if the log level is WARNING."""
    _, walk_map = opened()
    walk[-1].fuse(walk_map)
    assert "walk 'w' continues from step 3" in caplog.text


def test_a_pause_that_is_scanned_again_goes_on_from_the_pause_before(
    walk: list[Scanned], killed: list[Path], opened: Callable[..., tuple]
) -> None:
    """A node started during a pause receives its BEGIN again."""
    journal, walk_map = opened()
    walk[LAST].fuse(walk_map)
    assert journal.item().message == "walk 'w' continues from step 2"


NOT_SAID = "the gait reports fewer than two feet that never left the ground since step 3"
MISFITS = {
    "an earlier gait": ({"standing_pauses": {}}, NOT_SAID),
    "lifted": ({"standing_pauses": dict.fromkeys(LEGS, 0) | {"rh": 4}}, NOT_SAID),
    "a foot that swung is said to stand": (
        {"standing_pauses": dict.fromkeys(("lf", "lh", "rf", "rh"), 4)},
        "moved, but",
    ),
    "another walk": ({"epoch": "v"}, "the journal ends at step 3 of walk 'w'; this is step 4 of 'v'"),
    "old": ({"time": BEGUN + 1000.0}, "the stored walk is 970 s old, but ground is valid for only 420 s"),
    "the clock went back": ({"time": 10.0}, "the stored walk is -1020 s old"),
    "no picture": ({"picture": "no frame without laser"}, "the first image: no frame without laser"),
}


@pytest.mark.parametrize("kind", MISFITS)
def test_what_does_not_fit_begins_a_new_walk(
    kind: str, walk: list[Scanned], killed: list[Path], opened: Callable[..., tuple], fresh: gp.TerrainGrid
) -> None:
    """No earlier ground is published; status and map state the reason, and the journal is removed."""
    changes, why = MISFITS[kind]
    journal, walk_map = opened()
    fused = walk[-1].fuse(walk_map, **changes)
    assert np.array_equal(np.isfinite(fused.elevation), np.isfinite(fresh.elevation))
    item = journal.item()
    assert item.level is Health.WARN
    assert item.message.startswith("a new walk begins: ")
    assert why in item.message
    assert item.values["refused"] == "1"
    assert any(why in reason for reason in fused.metadata["health"]["reasons"])
    assert not any(path.exists() for path in killed)


def turned(pause: WalkPause, axis: int, degrees: float) -> Float:
    """Rotation (4, 4) about an axis of the world through the robot's footprint."""
    about, motion = pause.transform_footprint_to_world[:3, 3], np.eye(4)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    motion[a, a] = motion[b, b] = cosine
    motion[a, b], motion[b, a] = -sine, sine
    motion[:3, 3] = about - motion[:3, :3] @ about
    return motion


def aside(x: float, y: float) -> Float:
    motion = np.eye(4)
    motion[:2, 3] = x, y
    return motion


CARRIED = {
    "by 20 mm": lambda pause: aside(0.0, 0.02),
    "by 20 mm ahead": lambda pause: aside(0.02, 0.0),
    "by 1 m": lambda pause: aside(0.8, 0.6),
    "turned by 2 degrees": lambda pause: turned(pause, 2, 2.0),
    "turned about": lambda pause: turned(pause, 2, 180.0),
    "tilted": lambda pause: turned(pause, 1, 3.0),
}


@pytest.mark.parametrize("how", CARRIED)
def test_a_robot_that_was_carried_with_stiff_legs_begins_a_new_walk(
    how: str,
    walk: list[Scanned],
    killed: list[Path],
    opened: Callable[..., tuple],
    scan: Callable[..., Scanned],
    robot: RobotModel,
    calibration: gp.Calibration,
) -> None:
    """Its joints are unchanged, the ground is level, and its gait claims that no foot was lifted."""
    pause = walk[LAST].pause
    moved = CARRIED[how](pause)
    base = pause.transform_base_to_world[:3, :3]
    gravity = (moved[:3, :3] @ base).T @ base @ np.array(pause.stance.gravity_in_base)
    stance = Stance(pause.stance.joint_positions, pause.stance.support_feet, tuple(gravity.tolist()))
    scanned = scan(pause, moved, stance, LAST + 1)
    journal, walk_map = opened()
    assert same(scanned.fuse(walk_map), scanned.fuse(WalkMap(robot, calibration)))
    assert journal.item().values["refused"] == "1"


def test_a_walk_without_gravity_is_not_gone_on_with(
    walk: list[Scanned], killed: list[Path], opened: Callable[..., tuple]
) -> None:
    """Agreement of gravity cannot be shown."""
    journal, walk_map = opened()
    stance = Stance(walk[-1].stance.joint_positions, walk[-1].stance.support_feet)
    walk[-1].fuse(walk_map, stance=stance)
    assert "gravity is not known" in journal.item().message


def test_a_withdrawn_first_pause_proves_nothing(
    walk: list[Scanned],
    killed: list[Path],
    opened: Callable[..., tuple],
    uninterrupted: gp.TerrainGrid,
    robot: RobotModel,
    calibration: gp.Calibration,
) -> None:
    """Its ground is withdrawn with it, and the next pause is checked again."""
    journal, walk_map = opened()
    walk[LAST].fuse(walk_map)
    nothing = gp.ScanProcessor(calibration, robot, walk[LAST].stance, "coarse", step=LAST).finish()
    withdrawn = walk_map.withdraw(nothing, time=BEGUN + PERIOD * LAST)
    assert not np.isfinite(withdrawn.elevation).any()
    assert same(walk[-1].fuse(walk_map), uninterrupted)
    assert journal.item().message == "walk 'w' continues from step 3"


SEALS = {"instance": "other", "robot": "00", "calibration": "11", "boot": "22"}


@pytest.mark.parametrize("what", SEALS)
def test_a_journal_of_something_else_is_refused_by_name(
    what: str, killed: list[Path], opened: Callable[..., tuple]
) -> None:
    """Journals of another robot folder, calibration or boot are refused; another instance uses another file name."""
    journal, _ = opened(**{what: SEALS[what]})
    assert journal.claims == ()
    if what == "instance":
        assert journal.item().message.startswith("no journal was found")
    else:
        assert f"{killed[1]}: {what} is " in journal.item().message
        assert journal.item().level is Health.WARN


def test_damaged_and_foreign_journals_are_refused_by_name(
    killed: list[Path], robot: RobotModel, seal: Seal, opened: Callable[..., tuple]
) -> None:
    """A flipped bit, another format or version, and an oversized file each give an error that names the file."""
    content, path = killed[1].read_bytes(), killed[1]
    chance = np.random.default_rng(0)
    for at in [0, 20, 90, *chance.integers(0, len(content), 20).tolist()]:
        damaged = bytearray(content)
        damaged[at] ^= 1 << int(chance.integers(0, 8))
        path.write_bytes(damaged)
        with pytest.raises(FileFormatError, match=path.name):
            Claim.read(path, robot, seal)
    for foreign, why in {
        b"notes": "format is 'notes'; allowed: 'guara-journal/1'",
        content.replace(b"journal/1", b"journal/2", 1): "format is 'guara-journal/2'",
    }.items():
        path.write_bytes(foreign)
        with pytest.raises(FileFormatError, match=why):
            Claim.read(path, robot, seal)
    with path.open("wb") as file:
        file.truncate(2**30)
    journal, _ = opened()
    assert "has more than 67108864 bytes" in journal.item().message


def test_a_pause_that_was_not_confirmed_leaves_no_journal(
    walk: list[Scanned], killed: list[Path], opened: Callable[..., tuple]
) -> None:
    """It stays in the temporary file, which the next node removes; other files are kept."""
    before = [path.read_bytes() for path in killed]
    journal, walk_map = opened()
    walk[-1].fuse(walk_map)
    other, beside = killed[0].parent / "notes.txt", killed[0].parent / ".guara.journal"
    other.write_text("mine")
    with journal:
        journal.write(walk_map.claim(BEGUN + PERIOD * walk[-1].step))
        assert wait_until(lambda: "bytes" in journal.item().values)
        assert stat.S_IMODE(beside.stat().st_mode) == 0o600
    assert [path.read_bytes() for path in killed] == before
    journal, _ = opened()
    assert [claim.step for claim in journal.claims] == [LAST, LAST, LAST - 1]
    assert not beside.exists()
    assert other.exists()


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path, robot: RobotModel, seal: Seal) -> None:
    """The error states what is allowed."""
    taken = tmp_path / "file"
    taken.write_text("")
    with pytest.raises(InvalidInput, match="--state is .*; allowed: a folder of this user"):
        Journal(taken, robot, seal)


def test_a_journal_that_cannot_be_written_stops_no_scan(walk: list[Scanned], opened: Callable[..., tuple]) -> None:
    """The status reports it until a journal is written again."""
    journal, walk_map = opened()
    walk[0].fuse(walk_map)
    path_of(journal).rmdir()
    with journal:
        journal.write(walk_map.claim(BEGUN))
        journal.confirm()
    assert journal.item().level is Health.WARN
    assert journal.item().message.startswith(
        "no journal was found: a new walk begins; the last claim was not written: "
    )
    assert journal.item().values["failed"] == "1"


def test_a_journal_of_an_earlier_version_is_read(robot: RobotModel) -> None:
    """Every released version, each with an example in tests/data/journal."""
    for path in OLD.glob("*.journal"):
        head = path.read_bytes().split(b"\n", 2)[1]
        fields = parse_json(head, path.name)
        seal = Seal(**{field.name: fields.text(field.name) for field in dataclasses.fields(Seal)})
        claim = Claim.read(path, robot, seal)
        assert (claim.epoch, claim.step, claim.map.pause) == ("w", 0, 0)
    assert FORMAT.split("/")[1] in {path.stem[-1] for path in OLD.glob("*.journal")}
