"""Worker processes that end with the command, however it ends: Ctrl-C, kill -9; and said if they die."""

from __future__ import annotations

import contextlib
import functools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from multiprocessing import connection, forkserver, parent_process, resource_tracker
from typing import TypeVar

from unidrive_cli.errors import UnidriveError

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def start_server(modules: Sequence[str]) -> None:
    """Starts the process that workers are forked from, which imports some modules meanwhile.

    A worker that imports them itself, and loads what they load, takes more than a second to start. Called again it
    does nothing; `in_workers` calls it where nobody has.
    """
    multiprocessing.get_context("forkserver").set_forkserver_preload(list(modules))
    resource_tracker.ensure_running()  # its start would let interrupts through again
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))  # one process per core
    try:
        with interrupts_held():
            forkserver.ensure_running()
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def in_workers(work: Callable[[Item], Outcome], items: Iterable[Item], jobs: int) -> Iterator[Outcome]:
    """The outcomes of `work` on all items, in the order in which they are done.

    Args:
        jobs: worker processes, at least 1.

    Raises:
        UnidriveError: a worker was killed.
    """
    function: object = work
    while isinstance(function, functools.partial):
        function = function.func
    start_server([str(function.__module__)])
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("forkserver")
    executor = ProcessPoolExecutor(jobs, context, initializer=_end_with_parent)
    waiting, pending = iter(items), set[Future[Outcome]]()
    try:
        while True:
            for item in islice(waiting, 2 * jobs - len(pending)):
                with interrupts_held():
                    pending.add(executor.submit(work, item))
            if not pending:
                break
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
        executor.shutdown()
    except BrokenProcessPool as error:
        raise UnidriveError(
            "a worker process was killed, most likely because memory ran out.",
            hint="The same command continues; try fewer --jobs.",
        ) from error
    finally:
        for process in set(multiprocessing.active_children()) - others:
            process.kill()
        executor.shutdown(wait=False, cancel_futures=True)


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Ctrl-C waits; processes started meanwhile never see it: this one ends them, without their tracebacks.

    The mask is what they inherit. It does not keep the signal from other threads of this process, which hand it to
    the main one: there the handlers wait too.
    """
    interrupts = {signal.SIGINT, signal.SIGTERM}
    is_main = threading.current_thread() is threading.main_thread()
    handlers = {number: signal.getsignal(number) for number in interrupts if is_main}
    held: list[int] = []
    signal.pthread_sigmask(signal.SIG_BLOCK, interrupts)
    for number in handlers:
        signal.signal(number, lambda seen, _: held.append(seen))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, interrupts)
        for seen in held:
            signal.raise_signal(seen)


def _end_with_parent() -> None:
    """Ends this process as soon as its parent has ended: after kill -9 nobody else would tell it.

    It could otherwise go on writing into a DST that has been given to another run.
    """
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
