"""Build hook of hatchling: leaves what the distribution guara-client holds to it, and compiles the kernel.

The kernel of stripe extraction is compiled with `cc` or, where there is none, with Zig.

The libraries lie beside their source: in the wheel, or in the checkout for an editable installation. There
`python hatch_build.py` compiles them alone. MACHINE=aarch64 (x86_64) builds for another processor, which takes Zig.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # Compiling alone needs no hatchling.
    BuildHookInterface = object

ROOT = Path(__file__).resolve().parent
FOLDER = ROOT / "guara_perception" / "stripes" / "kernel"
CLIENT = ROOT / ".ci" / "client"
# One library for each of these processors; the best is chosen when it is loaded.
PROCESSORS = {"x86_64": ("x86-64-v2", "x86-64-v3"), "aarch64": ("armv8-a",)}
ZIG_NAMES = {"x86-64-v2": "x86_64_v2", "x86-64-v3": "x86_64_v3", "armv8-a": "generic"}
# Contracted, a product and a sum would round otherwise on one processor than on another.
FLAGS = "-std=gnu11 -O3 -g0 -fno-math-errno -ffp-contract=off -shared -fPIC -Wall -Wextra".split()
# The whole compiler as a wheel; of any version, so this one. Its libraries need glibc 2.28 as all other wheels do.
ZIG = "ziglang==0.17.1"
GLIBC = "2.28"


def target_machine() -> str:
    """Machine for which is built."""
    machine = os.environ.get("MACHINE", platform.machine())
    if machine not in PROCESSORS:
        raise SystemExit(f"machine is {machine!r}, allowed: {', '.join(PROCESSORS)}")
    return machine


def native_compiler() -> list[str]:
    """Command of the system's compiler; empty where there is none, or it does not compile for the machine."""
    command = shlex.split(os.environ.get("CC", "cc"))
    return command if target_machine() == platform.machine() and shutil.which(command[0]) else []


def libraries() -> list[Path]:
    """The libraries for the target machine."""
    return [FOLDER / f"{processor}.so" for processor in PROCESSORS[target_machine()]]


def is_current() -> bool:
    """Test that all libraries are newer than their sources."""
    sources = [*FOLDER.glob("*.[ch]"), Path(__file__)]
    newest = max(source.stat().st_mtime for source in sources)
    return all(library.exists() and library.stat().st_mtime >= newest for library in libraries())


def sources_digest() -> str:
    """Digest of the kernel's sources; a library that was compiled from others is refused when it is loaded."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(FOLDER.glob("*.[ch]")))).hexdigest()


def compile_kernel() -> None:
    """Compile the libraries for the target machine.

    Raises:
        SystemExit: there is no compiler, or it fails.
    """
    native, machine = native_compiler(), target_machine()
    if not native and not importlib.util.find_spec("ziglang"):
        raise SystemExit(
            "the kernel of stripe extraction needs a compiler: install one (Debian: apt install gcc libc6-dev), "
            f"or pip install {ZIG}; without --no-build-isolation pip does that itself"
        )
    sources = f'-DSOURCES="{sources_digest()}"'
    for library in libraries():
        with tempfile.TemporaryDirectory(dir=FOLDER, prefix=".build-") as folder:
            made = Path(folder, library.name)
            command = [*native, f"-march={library.stem}"]
            if not native:
                command = [sys.executable, "-m", "ziglang", "cc", "-target", f"{machine}-linux-gnu.{GLIBC}"]
                command += [f"-mcpu={ZIG_NAMES[library.stem]}", "-fno-sanitize=undefined", "-s"]
            command += [*FLAGS, sources, "-o", str(made)]
            command += [*map(str, sorted(FOLDER.glob("*.c"))), "-lm"]
            # Zig keeps what it compiles once, its own C library too: not in the home of whoever installs.
            environment = os.environ | {"ZIG_GLOBAL_CACHE_DIR": folder, "ZIG_LOCAL_CACHE_DIR": folder}
            if subprocess.run(command, env=environment).returncode:
                raise SystemExit(f"the kernel of stripe extraction could not be compiled: {shlex.join(command)}")
            # In one step: another process may be loading it.
            made.replace(library)


def client_files() -> list[str]:
    """Files of the distribution guara-client, as its own hook lists them."""
    spec = importlib.util.spec_from_file_location("client_hook", CLIENT / "hatch_build.py")
    assert spec and spec.loader
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    return list(hook.client_files(ROOT))


class PerceptionHook(BuildHookInterface):
    """Compiles the kernel before a wheel or an editable installation is made."""

    def dependencies(self) -> list[str]:
        """Name what the build needs besides hatchling."""
        return [] if self.target_name != "wheel" or native_compiler() else [ZIG]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, put the libraries into the wheel, and leave out what guara-client holds.

        An editable installation has all of the checkout. A wheel built from a checkout needs the client of that
        checkout; one built from a source distribution needs the published one of the same version.
        """
        if self.target_name != "wheel":
            return
        if version == "standard":
            is_checkout = not (ROOT / "PKG-INFO").exists()
            source = f" @ {CLIENT.as_uri()}" if is_checkout else f"=={self.metadata.version}"
            build_data["dependencies"].append(f"guara-client{source}")
            self.build_config.target_config["exclude"] = [f"/{name}" for name in client_files()]
        compile_kernel()
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-linux_{target_machine()}"
        build_data["artifacts"] += [f"/{library.relative_to(FOLDER.parents[2])}" for library in libraries()]


if __name__ == "__main__":
    compile_kernel()
