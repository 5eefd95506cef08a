"""Worker processes that end with the command, however it ends: Ctrl-C, kill -9; and said if they die."""

from __future__ import annotations

import contextlib
import functools
import os
import select
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from multiprocessing import resource_tracker
from typing import TypeVar

from unidrive_cli.errors import UnidriveError

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")


def in_workers(work: Callable[[Item], Outcome], items: Iterable[Item], jobs: int) -> Iterator[Outcome]:
    """The outcomes of `work` on all items, in the order in which they are done.

    Args:
        jobs: worker processes, at least 1.

    Raises:
        UnidriveError: a worker was killed.
    """
    import joblib
    from joblib.externals.loky import get_reusable_executor
    from joblib.externals.loky.backend import resource_tracker as loky_tracker
    from joblib.externals.loky.process_executor import BrokenProcessPool

    parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
    try:
        resource_tracker.ensure_running()  # the start of either would let interrupts through again
        loky_tracker.ensure_running()
        with _interrupts_held():
            attended = functools.partial(_attended, work, os.getpid())
            outcomes = parallel(joblib.delayed(attended)(item) for item in items)
        yield from outcomes
    except KeyboardInterrupt:
        get_reusable_executor().shutdown(wait=False, kill_workers=True)
        raise
    except BrokenProcessPool as error:
        raise UnidriveError(
            "a worker process was killed, most likely because memory ran out.",
            hint="The same command continues; try fewer --jobs.",
        ) from error


def _attended(work: Callable[[Item], Outcome], parent: int, item: Item) -> Outcome:
    if os.getpid() != parent:  # one job is done in this process
        _end_with(parent)
    return work(item)


@functools.lru_cache(maxsize=1)
def _end_with(parent: int) -> None:
    """Ends this process as soon as its parent has ended: after kill -9 nobody else would tell it.

    It could otherwise go on writing into a DST that has been given to another run.
    """
    try:
        living = os.pidfd_open(parent)
    except ProcessLookupError:
        os._exit(1)
    except OSError:
        return  # a kernel before 5.3: what is queued is finished
    if os.getppid() != parent:  # it had ended already, and the number may be another process's
        os._exit(1)

    def wait() -> None:
        watch = select.poll()
        watch.register(living, select.POLLIN)
        watch.poll()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Ctrl-C waits; processes started meanwhile never see it: this one ends them, without their tracebacks."""
    interrupts = {signal.SIGINT, signal.SIGTERM}
    signal.pthread_sigmask(signal.SIG_BLOCK, interrupts)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, interrupts)
