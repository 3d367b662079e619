#!/usr/bin/env python3
"""LiteX's own RemoteServer and RemoteClient against a board: the identifier, a status word, a
describe word.

    remote_client.py ADDRESS:PORT CSR.CSV

Everything between the TCP client and the UDP datagram is LiteX's. Only the local UDP port is ours
to choose: CommUDP binds the board's port on every interface, which is taken when the simulated
board listens on the same machine.
"""

import json
import socket
import sys

from litex.tools.litex_client import RemoteClient
from litex.tools.litex_server import RemoteServer
from litex.tools.remote.comm_udp import CommUDP

DESCRIBE_MAGIC = 0x46435231


def main():
    address, port = sys.argv[1].rsplit(":", 1)
    csr_csv = sys.argv[2]

    comm = CommUDP(address, int(port), timeout=20.0)
    comm.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    comm.socket.bind(("127.0.0.1", 0))
    comm.socket.settimeout(comm.timeout)
    assert comm.probe(address, int(port)) == 1, "the board did not answer the probe"

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        tcp_port = free.getsockname()[1]
    server = RemoteServer(comm, "127.0.0.1", tcp_port, addr_width=32)
    server.open()
    server.start(4)

    client = RemoteClient(host="127.0.0.1", port=tcp_port, csr_csv=csr_csv)
    client.open()
    client.socket.settimeout(60.0)
    identifier = ""
    for i in range(256):
        character = client.read(client.bases.identifier_mem + 4 * i) & 0xFF
        if character == 0:
            break
        identifier += chr(character)
    found = {
        "identifier": identifier,
        "describe_magic": client.read(0x0000_0000),
        "clock_hz": client.read(0x0000_0018),
        "ident_clock_hz": client.regs.ident_sys_clk_hz.read(),
        "watchdog_status": client.regs.watchdog_status.read(),
        "burst": client.read(0x0000_0000, 16)[0],
    }
    print(json.dumps(found))
    assert found["describe_magic"] == DESCRIBE_MAGIC, "the describe window does not begin with its magic"
    assert found["burst"] == DESCRIBE_MAGIC, "a burst read begins elsewhere than a single one"
    assert found["clock_hz"] == found["ident_clock_hz"], "firmware and gateware disagree about the clock"
    client.close()
    sys.stdout.flush()
    # RemoteServer's threads have no way to be joined.
    import os

    os._exit(0)


main()
