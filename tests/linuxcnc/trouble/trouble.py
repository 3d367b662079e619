#!/usr/bin/python3
"""The "display" of a machine that gets into trouble: homes, cuts, something happens in the middle
of a G1, and an operator puts it right.

  FERROCNC_CONTROL   host:port of the simulated board's control channel
  FERROCNC_TROUBLE   what to say there when the axis is at speed: pull, reboot, power. `kill` ends LinuxCNC's realtime process instead
                     and leaves; `none` is the morning after: nothing happens, but where everything
                     stands is looked at first
  FERROCNC_MEND      what to say there when the machine stands: plug, or nothing

headless.py of the mill does the work. result.json says in the board's own clocks when what happened
(`progress`), so that the pins can be looked at for every stretch of it.
"""

import json
import os
import signal
import socket
import subprocess
import sys

import headless
import linuxcnc

# As complete.hal wires the sampler.
headless.COLUMNS += ["spindle_raw", "x_encoder_raw", "spindle_index"]

TROUBLE = os.environ["FERROCNC_TROUBLE"]
MEND = os.environ.get("FERROCNC_MEND", "")
CONTROL = os.environ["FERROCNC_CONTROL"].rsplit(":", 1)
# Units per second of X: the program's feed of 40 is 35 along X.
AT_SPEED = 30.0
# Servo periods in which a machine that was going to jump would have.
LOOK = 300
# Clocks of the board from the trouble to the look at what stands: 0.5 s, ten times what stopping
# takes.
SETTLED = 30_000_000


class Board:
    """The control channel."""

    def __init__(self):
        self.stream = socket.create_connection((CONTROL[0], int(CONTROL[1]))).makefile("rw")

    def say(self, words):
        self.stream.write(words + "\n")
        self.stream.flush()
        answer = self.stream.readline().strip()
        if not answer.startswith("ok"):
            raise headless.GiveUp(7, f"the board says {answer!r} to {words!r}")
        return dict(word.split("=", 1) for word in answer.split() if "=" in word)

    def clock(self):
        return int(self.say("fault")["clock"])


def run(machine, board, result):
    progress = result["progress"]

    def reached(name):
        progress[name] = board.clock()

    def pins():
        return {
            pin: headless.getp(f"ferrocnc.0.{pin}")
            for pin in ("fault-reason", "io-error", "enabled", "position-trusted", "packet-error-exceeded", "watchdog.has-bitten",
                        "last-reset-reason", "stepgen.x.counts", "stepgen.y.counts", "stepgen.z.counts", "packet-error-total")
        }

    machine.come_up()
    if TROUBLE == "none":
        machine.pass_periods(LOOK)
        result["back"] = pins()
        reached("enable")
    machine.start()
    if TROUBLE == "none":
        machine.pass_periods(LOOK)
        reached("enabled")
    machine.home()
    machine.begin()
    if TROUBLE == "none":
        return finish(machine, result, reached, pins)
    machine.wait(lambda s: abs(s.joint[0]["velocity"]) > AT_SPEED, "X is at speed")
    machine.poll()
    result["heard_before"] = list(machine.heard)
    machine.heard.clear()

    if TROUBLE == "kill":
        victim = subprocess.run(["pgrep", "-x", "rtapi_app"], capture_output=True, text=True, check=True).stdout
        reached("trouble")
        os.kill(int(victim), signal.SIGKILL)
        return
    progress["trouble"] = int(board.say(f"fault {TROUBLE}")["clock"])
    machine.wait(lambda s: s.task_state == linuxcnc.STATE_ESTOP, "the machine is off", keep_on=False)
    # A board that hears nothing has no time of its own in lockstep: it comes to rest in this one.
    left = progress["trouble"] + SETTLED - board.clock()
    if left > 0:
        board.say(f"run {left}")
    machine.poll()
    result["off"] = pins()
    reached("mend")
    if MEND:
        board.say(f"fault {MEND}")
    machine.wait(lambda s: headless.getp("ferrocnc.0.packet-error") == "FALSE", "the board answers again", keep_on=False)
    machine.pass_periods(LOOK)
    machine.poll()
    result["heard"] = list(machine.heard)
    result["back"] = pins()
    machine.heard.clear()

    reached("enable")
    machine.start()
    machine.pass_periods(LOOK)
    reached("enabled")
    result["enabled"] = pins()
    machine.home()
    machine.begin()
    finish(machine, result, reached, pins)


def finish(machine, result, reached, pins):
    machine.wait(
        lambda s: s.interp_state == linuxcnc.INTERP_IDLE and s.inpos and s.exec_state == linuxcnc.EXEC_DONE,
        "the program ends",
    )
    machine.rest()
    reached("end")
    result["end"] = pins()
    machine.poll()
    result["heard_after"] = list(machine.heard)


def main():
    os.makedirs(headless.OUT, exist_ok=True)
    open(headless.SAMPLES, "w").close()
    os.chmod(headless.SAMPLES, 0o666)
    recorder = subprocess.Popen(["halsampler", "-t", headless.SAMPLES])
    machine, board = headless.Machine(), Board()
    result = {"exit": 0, "text": "the machine was put right and the program ran to its end", "progress": {}}
    try:
        run(machine, board, result)
    except headless.GiveUp as reason:
        result.update(exit=reason.code, text=str(reason), heard_then=machine.heard)
    recorder.send_signal(signal.SIGTERM)
    try:
        recorder.wait(5)
    except subprocess.TimeoutExpired:
        recorder.kill()
    result["joints"] = list(machine.stat.joint_actual_position[:3])
    with open(os.path.join(headless.OUT, "result.json"), "w") as file:
        json.dump(result, file, indent=2)
    print(result["text"], flush=True)
    return result["exit"]


if __name__ == "__main__":
    sys.exit(main())
