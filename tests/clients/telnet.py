#!/usr/bin/env python3
"""A session with Debian's telnet on a terminal of its own.

    telnet.py HOST PORT characters|lines

In character mode telnet negotiates as it does at port 23 (`-PORT`), the board echoes each key, and
keys edit the line. In line mode telnet does not negotiate (any other port), and sends whole lines.
The exit status is not 0 if an expected text does not come within PATIENCE.
"""

import os
import pty
import select
import sys
import termios
import time

# A busy computer is slow; nothing is measured.
PATIENCE = 60.0

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


def main():
    host, port, mode = sys.argv[1:]
    characters = mode == "characters"
    to = ["--", "-" + port] if characters else [port]
    terminal = Terminal(["telnet", host, *to])
    terminal.expect(b"Escape character")
    # The prompt is expected together with the first keys.
    if characters:
        terminal.wait_for_echo_of_the_board()
    else:
        terminal.expect(b"ferrocnc> ")
    for keys, text in CHARACTERS if characters else LINES:
        os.write(terminal.file, keys)
        terminal.expect(text)
    terminal.expect(b"Connection closed")
    print(f"{mode}: {len(terminal.heard)} bytes, as expected")


if __name__ == "__main__":
    main()
