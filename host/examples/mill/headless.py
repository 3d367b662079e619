#!/usr/bin/python3
"""LinuxCNC's "display" without a screen: out of E-stop, machine on, home, one program, done.

Started by LinuxCNC as [DISPLAY]DISPLAY; what to do comes in the environment:

  FERROCNC_PROGRAM  the G-code file (default programs/rcone_short.ngc)
  FERROCNC_OUT      directory for samples.csv and result.json (default .)
  FERROCNC_PATIENCE seconds of the wall clock without any progress before giving up (default 120)

The exit code says how it went: 0 the program ran and every axis stands on the step it was sent to,
2 LinuxCNC did not come up, 3 no progress, 4 the machine dropped out, 5 it stands somewhere else, 6
LinuxCNC reported an error.

Nothing here depends on how fast the machine's time passes: behind a simulated board one servo
period may take a tenth of a second. Patience is counted from the last thing that changed.
"""

import csv
import json
import os
import signal
import subprocess
import sys
import time

import linuxcnc

HERE = os.path.dirname(os.path.abspath(__file__))
PROGRAM = os.path.abspath(os.environ.get("FERROCNC_PROGRAM", os.path.join(HERE, "programs/rcone_short.ngc")))
OUT = os.path.abspath(os.environ.get("FERROCNC_OUT", "."))
PATIENCE = float(os.environ.get("FERROCNC_PATIENCE", "120"))
AXES = "xyz"
# The position loop halves what is left every period: 80 periods after the last command nothing can
# be left.
STILL_PERIODS = 80
# A request was overheard if so many servo periods and seconds have passed without its effect. Only
# seconds would end what a busy computer has just begun.
OVERHEARD_PERIODS = 500
OVERHEARD = 15.0
# Servo periods in which something must have happened.
MOST_PERIODS = 3000
# As record.hal wires the sampler; the first column is the sample's number.
COLUMNS = (
    ["period"]
    + [f"{axis}_cmd" for axis in AXES]
    + [f"{axis}_fb" for axis in AXES]
    + [f"{axis}_counts" for axis in AXES]
    + ["enabled", "machine_on", "packet_errors", "margin_ns", "ticks_lsb", "ticks_msb"]
)


class GiveUp(Exception):
    """Ends the run with an exit code and a sentence."""

    def __init__(self, code, text):
        super().__init__(text)
        self.code = code


class Machine:
    """LinuxCNC through its Python interface."""

    def __init__(self):
        self.command = linuxcnc.command()
        self.stat = linuxcnc.stat()
        self.errors = linuxcnc.error_channel()
        self.heard = []

    def look(self, patience):
        """LinuxCNC's state. Its buffer cannot be read at every moment, e.g. at the start."""
        deadline = time.time() + patience
        while True:
            try:
                return self.stat.poll()
            except linuxcnc.error as error:
                if time.time() > deadline:
                    raise GiveUp(2, f"LinuxCNC's task does not answer: {error}") from error
            time.sleep(0.05)

    def come_up(self):
        self.look(PATIENCE)

    def poll(self):
        self.look(PATIENCE / 10)
        while True:
            message = self.errors.poll()
            if not message:
                return
            kind, text = message
            print(f"LinuxCNC says: {text}", flush=True)
            if kind in (linuxcnc.NML_ERROR, linuxcnc.OPERATOR_ERROR):
                self.heard.append(text)

    def progress(self):
        """What changes while LinuxCNC is getting on with it."""
        stat = self.stat
        return (
            stat.task_state,
            stat.interp_state,
            stat.motion_line,
            stat.read_line,
            tuple(stat.joint_position[:3]),
            tuple(stat.homed[:3]),
        )

    def where(self):
        """LinuxCNC's own view of its state, to find out why it does not go on."""
        stat = self.stat
        names = ("interp_state", "exec_state", "inpos", "queue", "motion_line", "read_line", "echo_serial_number", "paused")
        return ", ".join(f"{name} {getattr(stat, name)}" for name in names)

    def wait(self, condition, what, keep_on=True, again=None):
        """Until the condition holds. Gives up when the board's time stands still for PATIENCE, or
        when it passes without anything happening. `again` repeats a request that may have been
        overheard."""
        seen, since = (self.progress(), periods()), time.time()
        change, change_at = periods(), time.time()
        asked, asked_at = periods(), time.time()
        while True:
            self.poll()
            if condition(self.stat):
                return
            if keep_on and self.stat.task_state != linuxcnc.STATE_ON:
                raise GiveUp(4, f"the machine dropped out while waiting until {what}")
            now = (self.progress(), periods())
            if now[0] != seen[0]:
                change, change_at = periods(), time.time()
            if now != seen:
                seen, since = now, time.time()
            if time.time() - since > PATIENCE:
                raise GiveUp(3, f"the board's time stood still for {PATIENCE:.0f} s while waiting until {what}")
            if periods() - change > MOST_PERIODS and time.time() - change_at > PATIENCE:
                raise GiveUp(
                    3,
                    f"nothing happened for {MOST_PERIODS} servo periods while waiting until {what}; {self.where()}",
                )
            if again and periods() - asked > OVERHEARD_PERIODS and time.time() - asked_at > OVERHEARD:
                again()
                asked, asked_at = periods(), time.time()
            time.sleep(0.02)

    def run(self):
        self.come_up()
        self.start()
        print("armed, machine on", flush=True)
        self.home()
        print("homed", flush=True)
        self.begin()
        print(f"running {os.path.basename(PROGRAM)}", flush=True)
        self.wait(
            lambda s: s.interp_state == linuxcnc.INTERP_IDLE and s.inpos and s.exec_state == linuxcnc.EXEC_DONE,
            "the program ends",
        )
        self.rest()

    def start(self):
        """Out of E-stop, machine on."""
        self.leave_estop()
        self.wait(
            lambda s: s.task_state >= linuxcnc.STATE_ESTOP_RESET,
            "the board is armed",
            keep_on=False,
            again=self.leave_estop,
        )
        self.switch_on()
        self.wait(
            lambda s: s.task_state == linuxcnc.STATE_ON,
            "the machine is on",
            keep_on=False,
            again=self.switch_on,
        )

    def home(self):
        """All joints, whether they were homed before or not."""
        command = self.command
        command.mode(linuxcnc.MODE_MANUAL)
        self.wait(lambda s: s.task_mode == linuxcnc.MODE_MANUAL, "manual mode")
        command.teleop_enable(0)
        self.wait(lambda s: s.motion_mode == linuxcnc.TRAJ_MODE_FREE, "joint mode")
        if any(self.stat.homed[: self.stat.joints]):
            command.unhome(-1)
            self.wait(lambda s: not any(s.homed[: s.joints]), "no joint is homed")
        command.home(-1)
        self.wait(lambda s: all(s.homed[: s.joints]), "all joints are homed")

    def begin(self):
        """The program, from its first line."""
        command = self.command
        command.mode(linuxcnc.MODE_AUTO)
        self.wait(lambda s: s.task_mode == linuxcnc.MODE_AUTO, "automatic mode")
        command.program_open(PROGRAM)
        self.wait(lambda s: s.file == PROGRAM, "the program is open")
        command.auto(linuxcnc.AUTO_RUN, 0)
        self.wait(lambda s: s.interp_state != linuxcnc.INTERP_IDLE, "the program starts")

    def pass_periods(self, count):
        """Lets servo periods pass."""
        until = periods() + count
        self.wait(lambda _: periods() >= until, f"{count} servo periods have passed", keep_on=False)

    def switch_on(self):
        self.command.state(linuxcnc.STATE_ON)

    def leave_estop(self):
        self.command.state(linuxcnc.STATE_ESTOP)
        self.command.state(linuxcnc.STATE_ESTOP_RESET)

    def rest(self):
        """Until the recording shows STILL_PERIODS of standing still."""
        last = None
        deadline = time.time() + PATIENCE
        while time.time() < deadline:
            self.poll()
            rows = last_rows(STILL_PERIODS)
            if len(rows) >= STILL_PERIODS:
                here = [tuple(row[1:10]) for row in rows]
                commands_still = len({row[:3] for row in here}) == 1
                counts_still = len({row[6:9] for row in here}) == 1
                if commands_still and counts_still:
                    return
            now = rows[-1] if rows else None
            if now != last:
                last, deadline = now, time.time() + PATIENCE
            time.sleep(0.05)
        raise GiveUp(3, "the machine does not come to rest")


SAMPLES = os.path.join(OUT, "samples.raw")


def samples_size():
    try:
        return os.path.getsize(SAMPLES)
    except OSError:
        return 0


def periods():
    """Servo periods recorded, roughly: a line is about 90 bytes."""
    return samples_size() // 90


def parse(line):
    fields = line.split()
    if len(fields) != len(COLUMNS) or fields[0] == "overrun":
        return None
    return fields


def last_rows(count):
    with open(SAMPLES, "rb") as file:
        file.seek(max(0, samples_size() - 200 * count))
        lines = file.read().decode(errors="replace").split("\n")[1:-1]
    return [row for row in map(parse, lines) if row][-count:]


def ini_joints(key):
    ini = linuxcnc.ini(sys.argv[sys.argv.index("-ini") + 1])
    return [float(ini.find(f"JOINT_{joint}", key)) for joint in range(3)]


def getp(name):
    done = subprocess.run(["halcmd", "-s", "getp", name], capture_output=True, text=True)
    return done.stdout.strip()


def analyse(scales, accels, maxaccels):
    """Writes samples.csv and says how far apart command, feedback and pulses were."""
    with open(SAMPLES) as raw:
        rows = [row for row in map(parse, raw) if row]
    with open(os.path.join(OUT, "samples.csv"), "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(rows)

    def column(name):
        return [int(row[COLUMNS.index(name)]) for row in rows]

    moved = [i for i in range(1, len(rows)) if rows[i][1:4] != rows[i - 1][1:4]]
    axes = []
    for n, axis in enumerate(AXES):
        scale = scales[n]
        commands = [float(row[1 + n]) * scale for row in rows]
        feedback = [float(row[4 + n]) * scale for row in rows]
        counts = [int(row[7 + n]) for row in rows]
        # The command of period k is for its end; the counts read in period k + 2 were sampled
        # there.
        first, last = (moved[0], moved[-1]) if moved else (0, 0)
        span = range(first, min(last + 200, len(rows) - 2))
        off = [abs(counts[k + 2] - commands[k]) for k in span]
        follow = [abs(feedback[k + 1] - commands[k]) for k in span]
        worst = max(range(len(off)), key=lambda k: off[k], default=None)
        axes.append(
            {
                "name": axis,
                "scale": scale,
                "accel_steps": accels[n] * abs(scale),
                "maxaccel_steps": maxaccels[n] * abs(scale),
                "commanded_steps_at_rest": round(commands[-1]) if rows else None,
                "counts_at_rest": counts[-1] if rows else None,
                "deviation_at_rest_steps": counts[-1] - round(commands[-1]) if rows else None,
                "deviation_max_steps": off[worst] if worst is not None else 0,
                "following_error_max_steps": max(follow, default=0),
                "speed_max_steps_per_s": max((abs(commands[k] - commands[k - 1]) for k in span), default=0) * 1000,
            }
        )
    numbers = [int(row[0]) for row in rows]
    gaps = sum(1 for a, b in zip(numbers, numbers[1:]) if b != a + 1)
    return {
        "servo_periods": len(rows),
        "servo_periods_in_motion": len(moved),
        "gaps_in_recording": gaps,
        "packet_errors": column("packet_errors")[-1] if rows else None,
        "margin_ns_min": min((m for m in column("margin_ns") if m), default=None),
        "axes": axes,
    }


def main():
    os.makedirs(OUT, exist_ok=True)
    open(SAMPLES, "w").close()
    os.chmod(SAMPLES, 0o666)
    recorder = subprocess.Popen(["halsampler", "-t", SAMPLES])
    machine = Machine()
    result = {"program": PROGRAM, "exit": 0, "text": "the program ran to its end"}
    started = time.time()
    try:
        machine.run()
        if machine.heard:
            raise GiveUp(6, machine.heard[0])
    except GiveUp as reason:
        result.update(exit=reason.code, text=str(reason))
    result["wall_seconds"] = round(time.time() - started, 2)
    result["messages"] = machine.heard
    time.sleep(0.3)
    recorder.send_signal(signal.SIGTERM)
    try:
        recorder.wait(5)
    except subprocess.TimeoutExpired:
        recorder.kill()
    result.update(analyse(*map(ini_joints, ("SCALE", "MAX_ACCELERATION", "STEPGEN_MAXACCEL"))))
    for key, pin in (
        ("refused_total", "ferrocnc.0.refused-total"),
        ("fault_reason", "ferrocnc.0.fault-reason"),
        ("margin_ns_min_armed", "ferrocnc.0.watchdog.margin-ns-min"),
        ("read_tmax_clocks", "ferrocnc.0.read.tmax"),
        ("write_tmax_clocks", "ferrocnc.0.write.tmax"),
    ):
        result[key] = getp(pin)
    off = [axis["name"] for axis in result["axes"] if axis["deviation_at_rest_steps"]]
    if result["exit"] == 0 and off:
        result.update(exit=5, text=f"axes not on their step at rest: {', '.join(off)}")
    with open(os.path.join(OUT, "result.json"), "w") as file:
        json.dump(result, file, indent=2)
    print(result["text"], flush=True)
    return result["exit"]


if __name__ == "__main__":
    sys.exit(main())
