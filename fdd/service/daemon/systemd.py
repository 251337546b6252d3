"""What systemd wants to hear: ready, reloading, stopping, alive; a datagram to the socket that it names."""

from __future__ import annotations

import os
import socket
import time as clock


def notify(message: str) -> bool:
    """Send a message such as ``READY=1``; False where nobody listens."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return False
    if address.startswith("@"):
        address = "\0" + address[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
        try:
            out.sendto(message.encode(), address)
        except OSError:
            return False
    return True


class Watchdog:
    """Says that the service is alive, twice as often as systemd asks; does nothing where it does not ask."""

    def __init__(self) -> None:
        own = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._every = int(os.environ.get("WATCHDOG_USEC", "0")) / 2e6 if own else 0.0
        self._last = 0.0

    def alive(self) -> None:
        """Call it on every turn of the loop that must not hang."""
        if self._every and clock.monotonic() - self._last >= self._every:
            self._last = clock.monotonic()
            notify("WATCHDOG=1")


def reloading() -> None:
    """Say that the service reads its files again; ``READY=1`` says that it has."""
    notify(f"RELOADING=1\nMONOTONIC_USEC={clock.monotonic_ns() // 1000}")
