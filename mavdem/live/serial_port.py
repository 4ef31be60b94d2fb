"""A serial port for raw bytes: by termios(3) on POSIX, and by the package pyserial on Windows.

Some autopilots and radios reset when a modem line changes. So a port neither waits for a carrier, nor hangs up at its
end, nor uses hardware flow control.
"""

import contextlib
import os
import select
import sys
from typing import Any, Protocol

from mavdem.facts.session import LinkError

if sys.platform != "win32":
    import termios
    import tty

DEFAULT_BAUD = "115200"
"""Speed of a serial port whose connection string names none: the usual one of autopilots' USB ports."""

MAX_SERIAL_BYTES = 4096
"""Most bytes that are read from a port at once: the size of the kernel's buffer on Linux."""

_TERMIOS_CONTROL_MODES = 2
_TERMIOS_INPUT_SPEED = 4
_TERMIOS_OUTPUT_SPEED = 5
"""Indices into the list that ``termios.tcgetattr`` returns."""


class SerialPort(Protocol):
    """An open serial port, on any operating system."""

    def wait(self, timeout: float) -> bool:
        """Waits until bytes have come, or for ``timeout`` seconds, and returns whether they have."""

    def read(self) -> bytes:
        """Returns the bytes that have come; none if the port has hung up.

        Raises:
            BlockingIOError: nothing has come.
            OSError: the port is lost.
        """

    def write(self, content: bytes) -> None:
        """Sends bytes as far as there is room for them, without waiting; raises ``OSError`` where the port is lost."""

    def close(self) -> None:
        """Closes the port; it may be lost already."""


class NoSerialPort(Exception):
    """A serial port cannot be used.

    Attributes:
        cause: why not.
        speed: the speed that it does not have; empty for another cause.
    """

    def __init__(self, cause: LinkError, speed: str = "") -> None:
        super().__init__(cause)
        self.cause = cause
        self.speed = speed


def open_serial_port(name: str) -> SerialPort:
    """Opens a serial port.

    Args:
        name: path or name of the device, with the speed in bit/s after a comma; ``DEFAULT_BAUD`` unless given.

    Returns:
        The open port, which reads and writes without waiting.

    Raises:
        OSError: the device cannot be opened.
        NoSerialPort: it is no serial port, has no such speed, or pyserial is not installed.
    """
    device, _, speed = name.partition(",")
    if not (speed.isdigit() or not speed):
        raise NoSerialPort(LinkError.NO_SPEED, speed)
    if sys.platform == "win32":
        return PyserialPort(device, speed or DEFAULT_BAUD)
    else:
        return TerminalPort(device, speed or DEFAULT_BAUD)


class PyserialPort:
    """A serial port that pyserial opens."""

    def __init__(self, device: str, speed: str) -> None:
        """Opens the port.

        Args:
            device: its name, such as "COM3".
            speed: bit/s.

        Raises:
            OSError: it cannot be opened.
            NoSerialPort: it has no such speed, or pyserial is not installed.
        """
        try:
            import serial
        except ImportError:
            raise NoSerialPort(LinkError.NO_PYSERIAL) from None
        try:
            self._port: Any = serial.Serial(device, int(speed), write_timeout=0)
        except ValueError:
            raise NoSerialPort(LinkError.NO_SPEED, speed) from None
        # What came while ``wait`` waited: pyserial waits by reading.
        self._first_bytes = b""

    def wait(self, timeout: float) -> bool:
        """Waits until bytes have come; see ``SerialPort``."""
        if not self._first_bytes:
            self._port.timeout = timeout
            self._first_bytes = self._port.read(1)
        return bool(self._first_bytes)

    def read(self) -> bytes:
        """Returns the bytes that have come; see ``SerialPort``."""
        content = self._first_bytes + self._port.read(self._port.in_waiting)
        self._first_bytes = b""
        if not content:
            raise BlockingIOError
        return bytes(content)

    def write(self, content: bytes) -> None:
        """Sends bytes; see ``SerialPort``."""
        self._port.write(content)

    def close(self) -> None:
        """Closes the port; see ``SerialPort``."""
        with contextlib.suppress(OSError):
            self._port.close()


if sys.platform != "win32":

    class TerminalPort:
        """A serial port that is a terminal device of POSIX."""

        def __init__(self, device: str, speed: str) -> None:
            """Opens the port.

            Args:
                device: path of the device.
                speed: bit/s.

            Raises:
                OSError: it cannot be opened.
                NoSerialPort: it is no serial port, or has no such speed.
            """
            # The module termios has a constant for each speed that a port can have, such as B115200.
            baud = getattr(termios, f"B{speed}", None)
            if baud is None:
                raise NoSerialPort(LinkError.NO_SPEED, speed)
            self._descriptor = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                tty.setraw(self._descriptor, termios.TCSANOW)
                settings = termios.tcgetattr(self._descriptor)
                # Receive without a carrier; neither hang up at the end nor wait for the other side's handshake.
                settings[_TERMIOS_CONTROL_MODES] |= termios.CLOCAL | termios.CREAD
                settings[_TERMIOS_CONTROL_MODES] &= ~(termios.HUPCL | termios.CRTSCTS)
                settings[_TERMIOS_INPUT_SPEED] = baud
                settings[_TERMIOS_OUTPUT_SPEED] = baud
                termios.tcsetattr(self._descriptor, termios.TCSANOW, settings)
            except termios.error:
                self.close()
                raise NoSerialPort(LinkError.NOT_SERIAL) from None

        def wait(self, timeout: float) -> bool:
            """Waits until bytes have come; see ``SerialPort``."""
            return bool(select.select([self._descriptor], [], [], timeout)[0])

        def read(self) -> bytes:
            """Returns the bytes that have come; see ``SerialPort``."""
            return os.read(self._descriptor, MAX_SERIAL_BYTES)

        def write(self, content: bytes) -> None:
            """Sends bytes; see ``SerialPort``."""
            os.write(self._descriptor, content)

        def close(self) -> None:
            """Closes the port; see ``SerialPort``."""
            with contextlib.suppress(OSError):
                os.close(self._descriptor)
