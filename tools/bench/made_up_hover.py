"""A made-up hover in gusts, as the datagrams of a quadrotor, and a process of its own that sends them."""

from __future__ import annotations

import math
import multiprocessing
import socket
import time
from collections.abc import Iterator
from multiprocessing.process import BaseProcess

import numpy as np
from pymavlink.dialects.v20 import all as dialect


def hover(rate: float, seconds: float) -> Iterator[tuple[float, bytes]]:
    """Datagrams with the second at which each is sent: in the air, armed, from the start.

    Args:
        rate: of attitude and of motor outputs, Hz each.
        seconds: of flight.
    """
    vehicle, rng = dialect.MAVLink(None, srcSystem=1, srcComponent=1), np.random.default_rng(0)
    roll = speed = wind = 0.0
    for tick in range(round(seconds * rate)):
        now = tick / rate
        if tick % round(rate) == 0:
            yield now, vehicle.heartbeat_encode(2, 3, 128, 0, 4).pack(vehicle)
        push = round(20 * math.sin(5 * now) + 10 * math.sin(11.3 * now))
        wind += (-wind / 0.2) / rate + 2.0 * math.sqrt(2 / 0.2 / rate) * rng.standard_normal()
        speed += (0.3 * push + wind - 4.0 * speed - 9.0 * roll) / rate
        roll += speed / rate
        stamp = 10_000 + now * 1e3
        yield now, vehicle.attitude_encode(round(stamp), roll, 0.01, 0.2, speed, 0.0, 0.0).pack(vehicle)
        outputs = (1600 - push, 1600 + push, 1600 + push, 1600 - push, 0, 0, 0, 0)
        yield now, vehicle.servo_output_raw_encode(round(stamp * 1e3) % 2**32, 0, *outputs).pack(vehicle)


def sender(rate: float, seconds: float, port: int) -> BaseProcess:
    """A process, not yet started, that sends the hover to ``port`` of this machine at its own pace."""
    return multiprocessing.get_context("spawn").Process(target=_send, args=(rate, seconds, port))


def _send(rate: float, seconds: float, port: int) -> None:
    datagrams = list(hover(rate, seconds))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as outlet:
        begin = time.monotonic()
        for at, datagram in datagrams:
            time.sleep(max(begin + at - time.monotonic(), 0.0))
            outlet.sendto(datagram, ("127.0.0.1", port))
