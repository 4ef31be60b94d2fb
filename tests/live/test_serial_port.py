"""Serial ports as pyserial opens them, which Windows needs; ``test_link.py`` has those of POSIX."""

import os
import pty
import sys

from pytest import importorskip, mark, raises

from mavdem.facts.session import LinkError
from mavdem.live.serial_port import NoSerialPort, PyserialPort, open_serial_port


def test_pyserial_reads_what_has_come_and_sends():
    importorskip("serial")
    controller, device = pty.openpty()
    port = PyserialPort(os.ttyname(device), "57600")
    assert not port.wait(0.01)
    with raises(BlockingIOError):
        port.read()
    os.write(controller, b"\xfd\r\n\x00")
    assert port.wait(60.0) and port.read() == b"\xfd\r\n\x00"
    port.write(b"\r\n")
    assert os.read(controller, 9) == b"\r\n"
    port.close()
    for descriptor in (controller, device):
        os.close(descriptor)


@mark.parametrize("speed", ["fast", "-1"])
def test_a_port_has_no_such_speed(speed):
    with raises(NoSerialPort) as refused:
        open_serial_port(f"/dev/null,{speed}")
    assert (refused.value.cause, refused.value.speed) == (LinkError.NO_SPEED, speed)


def test_without_pyserial_the_error_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "serial", None)
    with raises(NoSerialPort) as refused:
        PyserialPort("COM3", "57600")
    assert refused.value.cause is LinkError.NO_PYSERIAL
