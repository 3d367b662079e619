#!/usr/bin/python3
"""The "display" of a machine that `ferrocnc machine write` made: homes all axes, runs the program,
says in result.json where every joint stands and what LinuxCNC said.

headless.py of the mill does the work; this records as many joints as there are.
"""

import json
import os
import signal
import subprocess
import sys
import time

import headless
import linuxcnc

INI = linuxcnc.ini(sys.argv[sys.argv.index("-ini") + 1])
JOINTS = int(INI.find("KINS", "JOINTS"))
# As the test writes custom.hal: command, feedback and counts of each joint.
headless.COLUMNS = ["period"] + [f"{what}{joint}" for joint in range(JOINTS) for what in ("cmd", "fb", "counts")]


class Machine(headless.Machine):
    def rest(self):
        """A tenth of a second of the machine's time after the program's end."""
        self.pass_periods(100)


def joints(rows):
    """Each motor in the last row, from where it stood at power-up: command and feedback in units,
    and its steps."""
    last = [float(field) for field in rows[-1][1:]]
    keys = ("command", "feedback", "counts")
    return [dict(zip(keys, last[3 * joint : 3 * joint + 3])) for joint in range(JOINTS)]


def main():
    os.makedirs(headless.OUT, exist_ok=True)
    open(headless.SAMPLES, "w").close()
    os.chmod(headless.SAMPLES, 0o666)
    recorder = subprocess.Popen(["halsampler", "-t", headless.SAMPLES])
    machine = Machine()
    result = {"exit": 0, "text": "the program ran to its end"}
    try:
        machine.run()
        if machine.heard:
            raise headless.GiveUp(6, machine.heard[0])
    except headless.GiveUp as reason:
        result.update(exit=reason.code, text=str(reason))
    machine.poll()
    stat = machine.stat
    result["messages"] = machine.heard
    result["homed"] = list(stat.homed[:JOINTS])
    result["position"] = dict(zip("xyzabcuvw", stat.actual_position))
    result["probe_tripped"] = stat.probe_tripped
    result["probed_z"] = stat.probed_position[2]
    result["spindle_rpm"] = stat.spindle[0]["speed"]
    time.sleep(0.3)
    recorder.send_signal(signal.SIGTERM)
    try:
        recorder.wait(5)
    except subprocess.TimeoutExpired:
        recorder.kill()
    rows = headless.last_rows(1)
    result["joints"] = joints(rows) if rows else []
    for joint, place in zip(result["joints"], stat.joint_actual_position):
        joint["place"] = place
    with open(os.path.join(headless.OUT, "result.json"), "w") as file:
        json.dump(result, file)
    print(result["text"], flush=True)
    return result["exit"]


if __name__ == "__main__":
    sys.exit(main())
