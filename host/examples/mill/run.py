#!/usr/bin/env python3
"""Runs the mill without a screen, against a board or a simulated one.

  host/examples/mill/run.py --board 127.0.0.1:1234 --out target/mill --lockstep

Copies this configuration to OUT/config, fills in the options, starts LinuxCNC and hands back
headless.py's exit code. samples.csv and result.json appear in OUT. Needs the module as
/usr/lib/linuxcnc/modules/ferrocnc.so (--module makes that link when root), and nothing else of
LinuxCNC running: HAL exists once per machine.
"""

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time

HERE = os.path.dirname(os.path.abspath(__file__))
MODULE = "/usr/lib/linuxcnc/modules/ferrocnc.so"
SHIPPED = "/usr/share/doc/linuxcnc/examples/sample-configs/sim/axis/rose_engine"
DEFAULT_PROGRAM = os.path.join(HERE, "programs/rcone_short.ngc")
# What LinuxCNC asks "still running, restart it?" about.
LOCK = "/tmp/linuxcnc.lock"
# HAL's and LinuxCNC's shared memory. What a crash left behind holds a locked mutex and hangs
# everything after it.
KEYS = ("0x48414c32", "0x48484c34", "0x00000064")
# Seconds a session that is ending may take.
ENDING_S = 20


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--board", default="127.0.0.1:1234", help="IP[:port] of the board")
    parser.add_argument("--program", default=DEFAULT_PROGRAM, help="G-code to run")
    parser.add_argument("--out", default="target/mill", help="directory for config, samples.csv, result.json")
    parser.add_argument("--config", default=HERE, help="directory of another machine's configuration")
    parser.add_argument("--ini", default="headless.ini", help="INI file in it")
    parser.add_argument("--hal", help="HAL file to run this machine with instead of mill.hal")
    parser.add_argument("--module", help="libferrocnc.so to link as the realtime module (root)")
    parser.add_argument("--lockstep", action="store_true", help="the board's time passes with the exchanges: wait for them")
    parser.add_argument("--read-timeout", type=int, help="nanoseconds to wait for an answer; lockstep: 2 s unless said otherwise")
    parser.add_argument("--patient", action="store_true", help="no realtime kernel here: long watchdog, wide following error")
    parser.add_argument("--timeout", type=float, default=3600, help="seconds of the wall clock for everything")
    parser.add_argument("--patience", type=float, default=120, help="seconds without progress")
    return parser.parse_args()


def shipped_program(config):
    """The shipped subroutine the default program calls. Machines that install no documentation
    (dpkg's path-exclude) do not have it; then it is fetched out of the same package."""
    if os.path.exists(os.path.join(SHIPPED, "rcone.ngc")):
        return
    print("no rcone.ngc on this machine (documentation excluded?); taking it out of the package linuxcnc-uspace")
    with tempfile.TemporaryDirectory() as directory:
        os.chmod(directory, 0o777)
        done = subprocess.run(["apt-get", "download", "linuxcnc-uspace"], cwd=directory)
        packages = [name for name in os.listdir(directory) if name.endswith(".deb")]
        if done.returncode or not packages:
            sys.exit("cannot download linuxcnc-uspace; name another program with --program")
        subprocess.run(["dpkg-deb", "-x", packages[0], "x"], cwd=directory, check=True)
        shutil.copy(os.path.join(directory, "x", SHIPPED.lstrip("/"), "rcone.ngc"), os.path.join(config, "programs"))


def set_value(text, key, value):
    text, found = re.subn(rf"(?m)^{key} *=.*$", f"{key} = {value}", text)
    if not found:
        sys.exit(f"no {key} in the INI file")
    return text


def configure(options, out):
    config = os.path.join(out, "config")
    shutil.rmtree(config, ignore_errors=True)
    shutil.copytree(options.config, config, ignore=shutil.ignore_patterns("__pycache__", "*.expanded", "*.var*"))
    # What another machine does not bring along is the mill's.
    for name in ("headless.py", "tool.tbl"):
        if not os.path.exists(os.path.join(config, name)):
            shutil.copy(os.path.join(HERE, name), config)
    path = os.path.join(config, options.ini)
    with open(path) as file:
        machine = file.read()
    if "#INCLUDE machine.inc" in machine:
        with open(os.path.join(config, "machine.inc")) as file:
            machine = machine.replace("#INCLUDE machine.inc", file.read())
    machine = set_value(machine, "BOARD", options.board)
    if options.hal:
        shutil.copy(options.hal, config)
        machine = machine.replace("HALFILE = mill.hal", f"HALFILE = {os.path.basename(options.hal)}")
    if options.lockstep:
        machine = set_value(machine, "PACKET_READ_TIMEOUT", 2_000_000_000)
        # user-request-enable is up for this long by the wall clock; a servo period may take a
        # quarter of a second, and one whose answer is lost longer.
        machine, found = re.subn(r"(?m)(^\[EMCIO\]\n(?:[^\[\n].*\n)*?CYCLE_TIME = ).*$", r"\g<1>1.0", machine)
        if not found:
            sys.exit("no CYCLE_TIME of EMCIO in the INI file")
    if options.patient:
        machine = set_value(machine, "PACKET_READ_TIMEOUT", 100_000_000)
        machine = set_value(machine, "WATCHDOG_NS", 500_000_000)
        machine = set_value(machine, "FERROR", 20)
        machine = set_value(machine, "MIN_FERROR", 20)
    if options.read_timeout:
        machine = set_value(machine, "PACKET_READ_TIMEOUT", options.read_timeout)
    with open(path, "w") as file:
        file.write(machine)
    return path


def alive(name):
    """Whether a program of that name runs; one that has ended and waits to be reaped does not."""
    listed = subprocess.run(["ps", "-C", name, "-o", "stat="], stdout=subprocess.PIPE, text=True).stdout
    return any(not state.startswith("Z") for state in listed.split())


def sweep():
    """Removes what a LinuxCNC that crashed left behind; one that runs is left alone and we are not
    started. One that is ending gets its time: LinuxCNC's scripts wait 5 s for it and then go."""
    until = time.monotonic() + ENDING_S
    while alive("rtapi_app"):
        if time.monotonic() > until:
            sys.exit("LinuxCNC or another HAL session is running; end it first")
        time.sleep(0.1)
    if os.path.exists(LOCK):
        os.remove(LOCK)
    for key in KEYS:
        subprocess.run(["ipcrm", "-M", key], stderr=subprocess.DEVNULL)


def install(module):
    module = os.path.abspath(module)
    if not os.path.exists(module):
        sys.exit(f"{module} does not exist; build it with cargo build --release -p ferrocnc")
    if os.path.realpath(MODULE) != os.path.realpath(module):
        try:
            if os.path.lexists(MODULE):
                os.remove(MODULE)
            os.symlink(module, MODULE)
        except PermissionError:
            sys.exit(f"cannot link {MODULE}; say: sudo ln -sf {module} {MODULE}")


def main():
    options = arguments()
    out = os.path.abspath(options.out)
    os.makedirs(out, exist_ok=True)
    if options.module:
        install(options.module)
    if not os.path.exists(MODULE):
        sys.exit(f"no {MODULE}; give --module target/release/libferrocnc.so once, as root")
    ini = configure(options, out)
    if options.program == DEFAULT_PROGRAM:
        shipped_program(os.path.dirname(ini))
    sweep()
    environment = dict(
        os.environ,
        FERROCNC_PROGRAM=os.path.abspath(options.program),
        FERROCNC_OUT=out,
        FERROCNC_PATIENCE=str(options.patience),
    )
    # A display we do not use must not be waited for.
    environment.pop("DISPLAY", None)
    if os.geteuid() == 0:
        environment.setdefault("RTAPI_UID", "1000")
        environment.setdefault("RTAPI_FIFO_PATH", f"/tmp/ferrocnc_rtapi_fifo_{os.getpid()}")
    result = os.path.join(out, "result.json")
    if os.path.exists(result):
        os.remove(result)
    with open(os.path.join(out, "linuxcnc.log"), "w") as log:
        linuxcnc = subprocess.Popen(
            ["linuxcnc", "-r", ini],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,
        )
        try:
            code = linuxcnc.wait(options.timeout)
        except (subprocess.TimeoutExpired, KeyboardInterrupt):
            # Only our own session: LinuxCNC's script ends what it started.
            os.killpg(linuxcnc.pid, signal.SIGTERM)
            try:
                linuxcnc.wait(20)
            except subprocess.TimeoutExpired:
                os.killpg(linuxcnc.pid, signal.SIGKILL)
                linuxcnc.wait()
            code = 3
    fifo = environment.get("RTAPI_FIFO_PATH", "")
    if fifo.startswith("/tmp/ferrocnc_rtapi_fifo_") and os.path.exists(fifo):
        os.remove(fifo)
    with open(os.path.join(out, "linuxcnc.log")) as log:
        sys.stdout.write(log.read())
    if not os.path.exists(result):
        print(f"LinuxCNC did not come to running the program (exit {code}); see {out}/linuxcnc.log")
        return code or 2
    with open(result) as file:
        print(file.read())
    return code


if __name__ == "__main__":
    sys.exit(main())
