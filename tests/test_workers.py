"""Worker processes: what interrupts them, and when."""

from __future__ import annotations

import os
import signal
import threading
import time

import pytest

from unidrive_cli.workers import interrupts_held


def test_an_interrupt_waits_until_a_worker_has_started() -> None:
    """Though another thread of this process takes the signal."""
    end = threading.Event()
    other = threading.Thread(target=end.wait)
    other.start()
    reached = False
    try:
        with pytest.raises(KeyboardInterrupt), interrupts_held():  # noqa: PT012 - it is raised at the end of these
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.2)
            reached = True
    finally:
        end.set()
        other.join()
    assert reached
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, []) & {signal.SIGINT, signal.SIGTERM}
