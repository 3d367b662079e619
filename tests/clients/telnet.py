#!/usr/bin/env python3
"""A session with Debian's telnet on a terminal of its own.

    telnet.py HOST PORT characters|lines|armed|three

In character mode telnet negotiates as it does at port 23 (`-PORT`), the board echoes each key, and
keys edit the line. In line mode telnet does not negotiate (any other port), and sends whole lines.
With `armed` it looks at a board that a host keeps armed. With `three` there are three of them at
once, with half a line each before any of the lines ends, and a fourth that is refused until one has
gone. The exit status is not 0 if an expected text does not come within PATIENCE.
"""

import os
import pty
import select
import sys
import termios
import time

# A busy computer is slow; nothing is measured.
PATIENCE = float(os.environ.get("PATIENCE", "60"))

CHARACTERS = [
    (b"pwn", b"ferrocnc> pwn"),
    (b"\x7f", b"\x08\x1b[K"),
    (b"m 0\r", b"m 0\r\n0: period "),
    # Up, and the same answer again.
    (b"\x1b[A", b"ferrocnc> pwm 0\x1b[K"),
    (b"\r", b"\r\n0: period "),
    # To the line's beginning, and a letter there.
    (b"pio\x01g\r", b"inputs 0x"),
    (b"x" * 66, b"\x07\r\na line has at most 64 characters\r\n"),
    (b"\x03", b"^C\r\nferrocnc> "),
    (b"\x04", b"bye"),
]
LINES = [
    (b"pwm 0\r", b"\r\n0: period "),
    (b"status\r", b"session  free"),
    (b"quit\r", b"bye"),
]
ARMED = [
    (b"pwm 0\r", b"0: period "),
    (b"status\r", b"armed"),
    (b"quit\r", b"bye"),
]


class Terminal:
    """The terminal that telnet runs on."""

    def __init__(self, command):
        pid, self.file = pty.fork()
        if pid == 0:
            os.environ["TERM"] = "vt100"
            os.execvp(command[0], command)
        self.heard = b""
        self.at = 0

    def wait_for_echo_of_the_board(self):
        """telnet turns the terminal's own echo off once it has agreed to the board's."""
        end = time.monotonic() + PATIENCE
        while termios.tcgetattr(self.file)[3] & termios.ECHO:
            if time.monotonic() > end:
                sys.exit("telnet has not agreed to an echo of the board")
            time.sleep(0.01)

    def expect(self, text):
        """Waits for this text behind the last one."""
        end = time.monotonic() + PATIENCE
        while text not in self.heard[self.at :]:
            ready, _, _ = select.select([self.file], [], [], max(0.0, end - time.monotonic()))
            try:
                more = os.read(self.file, 4096) if ready else b""
            except OSError:
                more = b""
            if not more:
                sys.exit(f"no {text!r} behind {self.heard[self.at :]!r} in {self.heard!r}")
            self.heard += more
        self.at = self.heard.index(text, self.at) + len(text)


def three(host, port):
    """Three clients have a console each; a fourth has one when one of them has gone."""
    all = [Terminal(["telnet", host, "--", "-" + port]) for _ in range(3)]
    for terminal in all:
        terminal.expect(b"Escape character")
        terminal.wait_for_echo_of_the_board()
        terminal.expect(b"ferrocnc> ")
    for keys in (b"pw", b"m ", b"0\r"):
        for terminal in all:
            os.write(terminal.file, keys)
            terminal.expect(keys.rstrip(b"\r"))
    for terminal in all:
        terminal.expect(b"\r\n0: period ")
        terminal.expect(b"ferrocnc> ")
    Terminal(["telnet", host, port]).expect(b"Connection refused")
    os.write(all[1].file, b"quit\r")
    all[1].expect(b"bye")
    all[1].expect(b"Connection closed")
    fourth = Terminal(["telnet", host, "--", "-" + port])
    fourth.expect(b"ferrocnc> ")
    for terminal in (all[0], all[2], fourth):
        os.write(terminal.file, b"\x04")
        terminal.expect(b"bye")
        terminal.expect(b"Connection closed")
    print("three consoles and a fourth client, as expected")


def main():
    host, port, mode = sys.argv[1:]
    if mode == "three":
        return three(host, port)
    characters = mode == "characters"
    to = ["--", "-" + port] if characters else [port]
    session = {"characters": CHARACTERS, "lines": LINES, "armed": ARMED}[mode]
    terminal = Terminal(["telnet", host, *to])
    terminal.expect(b"Escape character")
    # The prompt is expected together with the first keys.
    if characters:
        terminal.wait_for_echo_of_the_board()
    else:
        terminal.expect(b"ferrocnc> ")
    for keys, text in session:
        os.write(terminal.file, keys)
        terminal.expect(text)
    terminal.expect(b"Connection closed")
    print(f"{mode}: {len(terminal.heard)} bytes, as expected")


if __name__ == "__main__":
    main()
