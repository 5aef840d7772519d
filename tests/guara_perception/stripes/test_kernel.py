"""The compiled kernel: its installation, its memory, threads, and slow references of what it computes."""

import itertools
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
import hatch_build
from guara_perception.app.main import main
from guara_perception.exceptions import DamagedInstallation
from guara_perception.stripes.band import Band
from guara_perception.stripes.kernel import library
from guara_perception.stripes.precise import extract_in_any_light
from testbed.synthetic_stripes import CASES, stripes
from tests.guara_perception.stripes.kernel_parts import part, strongest_ridge
from tests.guara_perception.stripes.plain_any_light import find_path
from tests.guara_perception.stripes.plain_laser_colour import SIGMAS_PX, ridge_of_width

HOSTILE = """
import dataclasses
import sys
from pathlib import Path
import cv2
import numpy as np
from guara_perception.stripes.kernel import library
library.FOLDER = Path(sys.argv[1])
import guara_perception as gp
from guara_perception.calibration.calibration import CameraModel
from guara_perception.calibration.drift import find_floor_lines
from guara_perception.ranging.locate import Triangulator
from guara_perception.ranging.stripe_points import stripe_points
from guara_perception.ranging.surface import surface_keys, surface_of
from guara_perception.scanning.background import grey
from guara_perception.scanning.flash_proof import second_line
from guara_perception.scanning.light_diagnosis import FrameSamples
from guara_perception.stripes.band import PROFILE_ARRAYS, pictures_of
from guara_perception.terrain.assessment.assess import DiscTests, assess_layers
from guara_perception.terrain.assessment.causes import LookPlan, behind_surface, lowest_ground
from guara_perception.terrain.assessment.raster import Raster, merge, rasterise
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.scan.assess_terrain import default_limits

cv2.setNumThreads(1)
random = np.random.default_rng(0)
for number in range(60):
    shape = tuple(random.integers(8, 70, 2)) + ((), (1,), (3,))[number % 3]
    kind = (np.uint8, np.uint16)[number % 2]
    most = np.iinfo(kind).max
    on = random.integers(0, random.choice([2, most // 8, most]) + 1, shape).astype(kind)
    on[shape[0] // 2 :][: number % 5] = most
    off = (None, on // 2, random.integers(0, most, shape).astype(kind))[number // 3 % 3]
    flipped = np.s_[:: random.choice([1, -1]), :: random.choice([1, -1])]
    pair = on[flipped], None if off is None else off[flipped]
    profile = gp.extract_stripe(*pair, ("columns", "rows")[number // 2 % 2])
    grey(pair[0], 1.0)
    given, factor = pictures_of(pair[0], None)[0], number % 4 + 1
    reference = random.integers(0, 256, (given.rows // factor, given.columns // factor), np.uint8)
    corners, moved = random.uniform(-2.0, 72.0 / factor, (40, 2)), np.empty((40, 2), np.float32)
    corners[0] = np.nan
    turn, rows, by_motion = (random.normal(size=(*size, 6)) for size in ((40,), (40, 2), (4,)))
    memory = library.addresses(reference, corners, turn, rows)
    limits, found, work = (number % 3, 0.1, 4, 1e-9, 1e9), np.empty(9), np.empty(6 * 40)
    places = library.address(by_motion), 4, *library.addresses(work, found)
    how = 0, factor, 255.0 / most
    library.kernel().look_at_corners(given, *how, *memory, 40, number % 31, *random.uniform(0, 70, 2), *limits, *places)
    flow, used = random.normal(size=(40, 2)), random.permutation(40)
    memory, places = library.addresses(rows, flow, moved, used), (library.address(by_motion), 4)
    library.kernel().fit_motion(*memory, 40, *limits, *places, *library.addresses(work, found))
    pad = max(16 - len(profile.status), 0)
    padded = {name: np.pad(getattr(profile, name), (0, pad)) for name in PROFILE_ARRAYS}
    profiles = [dataclasses.replace(profile, **padded) for _ in range(number % 3 + 1)]
    camera = CameraModel((max(len(profile.status), 16), 70), np.diag((60.0, 60.0, 1.0)), np.zeros(5))
    planes = random.normal(size=(len(profiles), 4))
    stripe_points(profiles, Triangulator(camera, np.eye(4)), planes, (-1.0, 1.0), lambda points: points[:, 0] > 0.1)
    stripes = stripe_points(profiles, Triangulator(camera, np.eye(4)), planes, (-9.0, 9.0))
    surface_of(dict(enumerate(stripes)), surface_keys(range(len(stripes)), range(3)), range(3), 9.0, 0.1)
    surface, targets = random.normal(0, 0.1, (9, 7)).astype(np.float32), random.normal(size=(30, 3))
    surface[::4] = targets[0] = np.nan
    geometry = GridGeometry((-0.2, -0.3), 0.05, (9, 7))
    behind_surface(surface, targets, random.normal(size=3) + (0, 0, number % 4), geometry)
    own = np.random.default_rng(number)
    behind_surface(surface, targets, own.normal(size=(number % 3, 3)), geometry)
    lowest_ground(surface, own.permutation(63)[: number % 64], geometry)
    plan = LookPlan(geometry, own.normal(size=(3, 4)), lambda points: points[:, :2], (9, 9))
    plan.unmet(surface, own.random(2) < 0.7, own.normal(size=3))
    heights = np.where(own.random(shape[:2]) < 0.2 * (number % 6), np.nan, own.normal(0, 0.01, shape[:2]))
    ground, none = Raster(heights, abs(heights), heights, heights), np.zeros(shape[:2], np.uint16)
    limits, discs = dataclasses.replace(default_limits(), disc_radius=own.uniform(0.004, 0.12)), DiscTests()
    for _ in range(2):
        assess_layers(ground, none, 0.005, limits, discs=discs)
        ground = ground.with_columns(slice(3, 5), ground.window(np.s_[:, 4:6]))
    swath = rasterise(np.vstack((targets, targets * 1e9)), np.ones(60), geometry)
    merge([swath, swath], geometry, (None, slice(2, 5))[number % 2])
    find_floor_lines({each: random.normal(size=(number, 3)) * random.choice([1, np.nan]) for each in range(number % 3)})
    FrameSamples([0], pair[0].shape[1::-1]).add(gp.FramePair(0, *pair), profile)
    if number // 2 % 2 == 0:
        second_line(gp.FramePair(0, *pair), profile)
# Pairs so wide that paths are looked for in fewer columns: noise, white pixels, and lines with a ghost.
for number in range(12):
    rows, columns = int(random.integers(32, 70)), int(random.choice([480, 481, 635, 999, 1000, 1003]))
    on, off = random.integers(0, random.choice([3, 32, 256]), (2, rows, columns, 3)).astype(np.uint8)
    on[::9, :: number % 4 + 1] = 255
    gp.extract_stripe(on[:: 1 - number % 2 * 2, ::-1], off[:: 1 - number % 2 * 2, ::-1])
    centre = 20 + 8 * np.sin(np.arange(columns) / 40)
    line = 200 * np.exp(-0.5 * ((np.arange(rows)[:, None] - centre) / random.choice([1, 3, 6])) ** 2)
    light = (line + 0.9 * np.roll(line, 14, axis=0))[:, :, None] * (0.1, 0.3, 1)
    pair = 60 + random.normal(0, 12, (2, rows, columns, 3)) + [light, 0 * light]
    gp.extract_stripe(*pair.clip(0, 255).astype(np.uint8))
    gp.extract_stripe(pair[0].clip(0, 255).astype(np.uint8))
    gp.extract_stripe(*(pair[:, :, :, 2].clip(0, 255) * 257).astype(np.uint16))
print("done")
"""


@pytest.fixture
def other_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder without libraries, from which the kernel is loaded during a test."""
    monkeypatch.setattr(library, "FOLDER", tmp_path)
    library.kernel.cache_clear()
    yield tmp_path
    library.kernel.cache_clear()


def copy_sources(folder: Path) -> Path:
    """Copy the sources of the kernel to a checkout; return its hatch_build.py."""
    shutil.copytree(
        library.FOLDER, folder / "guara_perception/stripes/kernel", ignore=shutil.ignore_patterns("*.so", "*.py")
    )
    return Path(shutil.copy(hatch_build.__file__, folder))


def test_a_missing_or_damaged_library_is_told_in_one_line(other_folder: Path) -> None:
    """The message has its path, the reason and the remedy."""
    path = other_folder / f"{library.processor()}.so"
    for damage in (None, b"", b"\x7fELF no library"):
        if damage is not None:
            path.write_bytes(damage)
        with pytest.raises(DamagedInstallation, match=r"kernel .*\.so cannot be loaded \(.*make install") as told:
            library.kernel()
        assert str(path) in str(told.value) and "\n" not in str(told.value)
        assert ("it is missing" in str(told.value)) == (damage is None)


def test_a_node_without_its_library_says_so_when_it_starts(
    other_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line, before any device is opened."""
    monkeypatch.setattr(sys, "argv", ["guara", "run", "--simulated"])
    with pytest.raises(SystemExit) as ended:
        main()
    told = capsys.readouterr().err
    assert ended.value.code == 1 and told.count("\n") == 1
    assert f"kernel {other_folder}" in told and "it is missing" in told


def test_a_library_of_other_sources_is_told(other_folder: Path) -> None:
    """Its functions may have the same names and other arguments."""
    here = Path(library.__file__).parent
    for each in (*here.glob("*.[ch]"), here / f"{library.processor()}.so"):
        shutil.copy(each, other_folder)
    library.kernel()
    library.kernel.cache_clear()
    with (other_folder / "version.c").open("a") as source:
        source.write("// changed")
    with pytest.raises(DamagedInstallation, match=r"compiled from other sources\): .*hatch_build"):
        library.kernel()


@pytest.mark.slow
def test_a_library_of_another_version_is_told(other_folder: Path) -> None:
    """The message names a function that it lacks."""
    compiler = hatch_build.native_compiler()
    if not compiler:
        pytest.skip("no compiler")
    source = other_folder / "other.c"
    source.write_text("int other;")
    path = other_folder / f"{library.processor()}.so"
    subprocess.run([*compiler, "-shared", "-fPIC", "-o", path, source], check=True)
    with pytest.raises(DamagedInstallation, match="undefined symbol: "):
        library.kernel()


@pytest.mark.slow
def test_without_a_compiler_the_build_says_what_to_install(tmp_path: Path) -> None:
    """One line, no traceback, nothing left behind."""
    script = copy_sources(tmp_path)
    environment = {"PATH": str(tmp_path)}
    # Isolated and without site-packages, in which Zig may be.
    done = subprocess.run(
        [sys.executable, "-I", "-S", script], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert "needs a compiler" in done.stderr and hatch_build.ZIG in done.stderr
    assert not [*tmp_path.rglob("*.so"), *tmp_path.rglob(".build-*")]


@pytest.mark.slow
@pytest.mark.parametrize("machine", hatch_build.PROCESSORS)
def test_zig_compiles_for_every_machine(tmp_path: Path, machine: str) -> None:
    """Without a compiler of the system; libraries of that machine."""
    if not find_spec("ziglang"):
        pytest.skip("ziglang is not installed")
    script = copy_sources(tmp_path)
    environment = os.environ | {"MACHINE": machine, "CC": "no-compiler"}
    subprocess.run([sys.executable, script], env=environment, check=True)
    code = {"x86_64": 62, "aarch64": 183}[machine]
    made = sorted(tmp_path.rglob("*.so"))
    assert [path.stem for path in made] == sorted(hatch_build.PROCESSORS[machine])
    for path in made:
        header = path.read_bytes()[:20]
        assert header[:4] == b"\x7fELF" and int.from_bytes(header[18:20], "little") == code


@pytest.mark.slow
def test_hostile_frames_touch_no_foreign_memory(tmp_path: Path, root: Path) -> None:
    """Any size, type, strides and levels under the address and undefined behaviour sanitizers of gcc."""
    if not shutil.which("gcc"):
        pytest.skip("no gcc")
    runtimes = [
        subprocess.run(["gcc", f"-print-file-name={name}"], capture_output=True, text=True, check=True).stdout.strip()
        for name in ("libasan.so", "libubsan.so")
    ]
    if not all(os.path.isabs(runtime) for runtime in runtimes):
        pytest.skip("gcc has no sanitizers")
    flags = [*hatch_build.FLAGS, "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    path = tmp_path / f"{library.processor()}.so"
    sources = sorted(library.FOLDER.glob("*.c"))
    subprocess.run(["gcc", f"-march={path.stem}", *flags, "-o", path, *sources, "-lm"], check=True)
    environment = os.environ | {
        "LD_PRELOAD": ":".join(runtimes),
        "ASAN_OPTIONS": "detect_leaks=0",
        "PYTHONPATH": str(root),
        "PYTHONMALLOC": "malloc",
    }
    done = subprocess.run(
        [sys.executable, "-c", HOSTILE, tmp_path], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout == "done\n", done.stderr[-3000:]


@pytest.mark.slow
def test_threads_and_order_change_nothing() -> None:
    """Frames in any light, with and without a laser-off picture, in two threads and in reverse order: the same bits."""
    pairs = [(on, off) for case in CASES for on, off, _ in stripes(case, count=2)]
    pairs += [(on, None) for on, _ in pairs[::2]]
    one_by_one = [gp.extract_stripe(on, off) for on, off in pairs]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda pair: gp.extract_stripe(*pair), pairs[::-1]))[::-1]
    for one, other in zip(one_by_one, together, strict=True):
        for name in ("position_px", "sigma_px", "status", "peak", "doubtful_px"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("has_off", [True, False])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_the_stripe_is_that_of_plain_array_operations(kind: type, channels: int, *, has_off: bool) -> None:
    """A line with a gap, in noise and in another exposure, with and without colour and a laser-off picture."""
    random = np.random.default_rng(6)
    rows, columns = 90, 320
    centre = 45 + 12 * np.sin(np.arange(columns) / 60)
    line = 90 * np.exp(-0.5 * ((np.arange(rows)[:, None] - centre) / 2) ** 2) * (np.arange(columns) // 40 != 4)
    light = line[:, :, None] * (0.1, 0.2, 1)
    scene = cv2.resize(random.uniform(20, 120, (9, 32, 3)), (columns, rows), interpolation=cv2.INTER_CUBIC)
    for gain, noise in ((1.0, 2.0), (1.3, 2.0), (1.0, 12.0)):
        on = scene + light + random.normal(0, noise, scene.shape)
        off = scene / gain + random.normal(0, noise, scene.shape)
        on, off = ((p.clip(0, 255) * np.iinfo(kind).max / 255).astype(kind)[:, :, 3 - channels :] for p in (on, off))
        found, plain = extract_in_any_light(Band(on, off if has_off else None)), find_path(on, off if has_off else None)
        is_found, is_plain = np.isfinite(found.position_px), plain.masks[1]
        assert not found.remark and 0.78 < is_found.mean() < 0.9
        # Both estimate the noise of ridges from samples, but from different columns.
        assert (is_found != is_plain).mean() < (0.01 if has_off else 0.08)
        assert (np.abs(found.position_px - plain.row)[is_found & is_plain] < 2).all()


def test_a_picture_exposed_unlike_is_used_if_it_shows_the_same_view() -> None:
    """It is scaled by its gain; moved by two rows it is not used, after a large change the pair is refused."""
    random = np.random.default_rng(7)
    scene = cv2.resize(random.uniform(20, 90, (12, 40, 3)), (320, 120), interpolation=cv2.INTER_CUBIC)
    light = 90 * np.exp(-0.5 * ((np.arange(120)[:, None] - 50) / 2) ** 2) * np.ones(320)
    on = (2.2 * scene + light[:, :, None] * (0.1, 0.2, 1) + random.normal(0, 1, scene.shape)).clip(0, 255)
    on = on.astype(np.uint8)
    alone = extract_in_any_light(Band(on, None))
    for shift, is_changed in itertools.product((0, 2), (False, True)):
        off = (np.roll(scene, shift, axis=0) + random.normal(0, 0.5, scene.shape)).clip(0, 255).astype(np.uint8)
        found = extract_in_any_light(Band(on, off), is_changed=is_changed)
        assert ("another scene" if shift and is_changed else "times as bright") in found.remark
        assert np.array_equal(found.position_px, alone.position_px, equal_nan=True) == (shift > 0)
        assert shift or (np.abs(found.position_px - 50) < 2).mean() > 0.95


def test_the_height_of_a_ridge_is_that_of_plain_array_operations() -> None:
    """The strongest of three widths, at pixels within and at the edges of a picture."""
    random = np.random.default_rng(2)
    light = random.normal(50, 9, (40, 31)).astype(np.float32)
    noises, taps = np.array([2.0, 1.0, 0.7]), np.zeros((3, 32), np.float32)
    for width, sigma in zip(taps, SIGMAS_PX, strict=True):
        size = 2 * int(np.ceil(2 * sigma)) + 1
        width[:size] = cv2.getGaussianKernel(size, sigma)[:, 0]
    heights = np.array([ridge_of_width(light, sigma) for sigma in SIGMAS_PX])
    strongest = (heights / noises[:, None, None]).argmax(axis=0)
    for row, column in ((0, 0), (3, 30), (20, 15), (39, 7)):
        height = strongest_ridge(light, row, column, noises, taps)
        assert height == pytest.approx(heights[strongest[row, column], row, column], abs=1e-3)


def test_memory_of_whole_pictures_is_not_kept() -> None:
    """That of a band is, for the next one."""
    assert library.memory(2000).ctypes.data == library.memory(1000).ctypes.data
    kept = library.memory(0)
    assert library.memory(library.MOST_KEPT + 1).ctypes.data != kept.ctypes.data
    assert library.memory(0) is kept and kept.size <= 1.2 * library.MOST_KEPT


def test_selected_values_are_those_of_a_sorted_list() -> None:
    """Few and many values, equal ones and both zeros, of any rank."""
    random = np.random.default_rng(4)
    for n in (1, 2, 7, 511, 512, 4000):
        for values in (random.normal(0, 5, n), random.integers(-3, 3, n), np.zeros(n)):
            rising = np.sort(values.astype(np.float32))
            for rank in {0, n // 3, n // 2, n - 1}:
                copy = values.astype(np.float32)
                assert part("select_value")(library.address(copy), n, rank) == rising[rank]
