"""The least that an event loop can do with a serial port: what comes there goes to one UDP port, and what that answers
goes back. Knows nothing of MAVLink; the yardstick of the serial benchmark. ``uvloop_echo.py DEVICE UDP_PORT``
"""

from __future__ import annotations

import os
import socket
import sys
import termios
import tty

import uvloop

READ_BYTES = 65536


def main(device: str, port: int) -> None:
    serial = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(serial, termios.TCSANOW)
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.connect(("127.0.0.1", port))
    udp.setblocking(False)
    loop = uvloop.new_event_loop()
    loop.add_reader(serial, lambda: udp.send(os.read(serial, READ_BYTES)))
    loop.add_reader(udp.fileno(), lambda: os.write(serial, udp.recv(READ_BYTES)))
    loop.run_forever()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
