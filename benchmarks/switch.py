"""An Ethernet switch whose cables can be made slow and lossy, from one socket per port.

    python benchmarks/switch.py SEED PORT ...        # lines on stdin: PORT DELAY_MS LOSS_PERCENT

Runs in the namespace that holds the ports. Frames go to all other ports. Stands in for netem,
which not every kernel has.
"""

from __future__ import annotations

import heapq
import os
import random
import select
import socket
import sys
import time

ALL_PROTOCOLS = 3
OUTGOING = 4
LONGEST = 65_536
IPV4, UDP = b"\x08\x00", 17
ETHERNET_BYTES = 14


def without_checksum(frame: bytes) -> bytes:
    """Return a UDP frame with checksum 0, which means none: it was left to hardware."""
    if frame[12:14] != IPV4 or frame[23] != UDP or frame[20] & 0x1F or frame[21]:
        return frame
    at = ETHERNET_BYTES + 4 * (frame[ETHERNET_BYTES] & 15) + 6
    return frame[:at] + b"\0\0" + frame[at + 2:]


def main(seed: int, names: list[str]) -> None:
    """Pass frames on until stdin ends."""
    rng = random.Random(seed)
    ports: dict[int, socket.socket] = {}
    for name in names:
        port = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ALL_PROTOCOLS))
        port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 24)
        port.bind((name, 0))
        port.setblocking(False)
        ports[port.fileno()] = port
    by_name = dict(zip(names, ports, strict=True))
    shapes = dict.fromkeys(ports, (0.0, 0.0))
    waiting: list[tuple[float, int, int, bytes]] = []
    number = 0
    while True:
        left = max(0.0, waiting[0][0] - time.monotonic()) if waiting else 1.0
        ready, _, _ = select.select([0, *ports], [], [], left)
        for source in ready:
            if source == 0:
                lines = os.read(0, 4096).decode().splitlines()
                if not lines:
                    return
                for line in lines:
                    name, delay_ms, percent = line.split()
                    shapes[by_name[name]] = float(delay_ms) * 1e-3, float(percent) * 1e-2
                continue
            try:
                frame, address = ports[source].recvfrom(LONGEST)
            except OSError:
                continue
            delay, loss = shapes[source]
            if address[2] != OUTGOING and not (loss and rng.random() < loss):
                number += 1
                heapq.heappush(waiting, (time.monotonic() + delay, number, source,
                                         without_checksum(frame)))
        now = time.monotonic()
        while waiting and waiting[0][0] <= now:
            _, _, source, frame = heapq.heappop(waiting)
            for target, port in ports.items():
                if target != source:
                    try:
                        port.send(frame)
                    except OSError:  # a pulled cable
                        continue


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
