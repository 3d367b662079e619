#!/usr/bin/env python3
"""FPGA G's words: `words.py HOST[:PORT] FILE` sends a file for `ferrocnc words`, in 30 lines.

The board has to know its machine (`ferrocnc job send --machine`). It is free again 5 s after this
program ends.
"""

import itertools
import socket
import struct
import sys
import time
import zlib
from pathlib import Path

HELLO, REPORT, WORDS = 1, 10, 11
COMMANDS = ["EMPTY", "GCODE", "STATUS", "START", "STOP"]
host, _, port = sys.argv[1].partition(":")
line = socket.create_connection((host, int(port or 724)), timeout=60)
answers, ids = line.makefile("rb"), itertools.count(1)


def ask(op, payload=b""):
    """A request and its answer (wire/src/jobs.rs): a head of 8 bytes, the payload, a CRC-32."""
    frame = struct.pack("<BBHHH", op, 0, next(ids), len(payload), 0) + payload
    line.sendall(frame + struct.pack("<I", zlib.crc32(frame)))
    _, status, _, length, _ = struct.unpack("<BBHHH", answers.read(8))
    if status:
        sys.exit(f"refused: status {status} of wire/src/jobs.rs")
    return answers.read(length + 4)[:length]


ask(HELLO, struct.pack("<I", int(time.time())))
for text in Path(sys.argv[2]).read_text().splitlines():
    if said := text.split("#")[0].split():
        command, words = COMMANDS.index(said[0]), [int(word, 0) for word in said[1:]]
        form = int(len(words) == 10)
        payload = struct.pack(f"<BBH{len(words)}I", command, form, 0, *words)
        (bits,) = struct.unpack("<I", ask(WORDS, payload))
        print(said[0], bits, "FULL" * (bits & 1), "DISPATCHERROR" * (bits >> 1 & 1))
steps = None
while steps != (steps := ask(REPORT)[24:36]):
    time.sleep(0.5)
print("steps", *struct.unpack("<iii", steps))
