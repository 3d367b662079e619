#!/usr/bin/python3
"""The "display" of complete.ini: homes, runs the program, says in result.json where the probe
tripped and where everything stands.

headless.py of the mill does the work; this adds columns and asks LinuxCNC for the probe.
"""

import json
import os
import signal
import subprocess
import sys
import time

import headless

headless.COLUMNS += ["spindle_raw", "x_encoder_raw", "spindle_index"]


def main():
    os.makedirs(headless.OUT, exist_ok=True)
    open(headless.SAMPLES, "w").close()
    os.chmod(headless.SAMPLES, 0o666)
    recorder = subprocess.Popen(["halsampler", "-t", headless.SAMPLES])
    machine = headless.Machine()
    result = {"exit": 0, "text": "the program ran to its end"}
    try:
        machine.run()
        if machine.heard:
            raise headless.GiveUp(6, machine.heard[0])
    except headless.GiveUp as reason:
        result.update(exit=reason.code, text=str(reason))
    machine.poll()
    result["messages"] = machine.heard
    result["probe_tripped"] = machine.stat.probe_tripped
    result["probed_z"] = machine.stat.probed_position[2]
    for pin in ("stepgen.z.position-latched", "stepgen.z.counts", "encoder.x.count", "stepgen.x.counts", "stepgen.y.counts",
                "encoder.spindle.quad-error"):
        result[pin] = headless.getp(f"ferrocnc.0.{pin}")
    time.sleep(0.3)
    recorder.send_signal(signal.SIGTERM)
    try:
        recorder.wait(5)
    except subprocess.TimeoutExpired:
        recorder.kill()
    result["joints"] = list(machine.stat.joint_actual_position[:3])
    with open(headless.SAMPLES) as samples:
        result["rows"] = [
            {name: float(value) if "." in value else int(value) for name, value in zip(headless.COLUMNS, row)}
            for row in filter(None, map(headless.parse, samples))
        ]
    with open(os.path.join(headless.OUT, "result.json"), "w") as file:
        json.dump(result, file)
    print(result["text"], flush=True)
    return result["exit"]


if __name__ == "__main__":
    sys.exit(main())
