"""A job of the daemon ends with the daemon, however that ended: its next run begins anew, and two never run at once."""

from __future__ import annotations

import os
import threading
import time as clock

PARENT = "FDD_PARENT"
"""Environment variable that tells a job whose it is."""
LOOK_SECONDS = 0.5


def end_with_parent() -> None:
    """Watch for the end of the daemon that started this process, if one did."""
    parent = os.environ.get(PARENT)
    if parent is None:
        return

    def watch() -> None:
        while os.getppid() == int(parent):
            clock.sleep(LOOK_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="parent").start()
