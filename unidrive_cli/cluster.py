"""Work on the machines of a Dask cluster: joblib's dask backend, watched, its failures said in sentences."""

from __future__ import annotations

import contextlib
import logging
import queue
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from typing import Any, TypeVar

import distributed
import joblib
from distributed.scheduler import KilledWorker
from joblib._dask import DaskDistributedBackend

from unidrive_cli import __version__
from unidrive_cli.errors import UnidriveError, UsageError

CONNECT_WITHIN_S = 10
WORKERS_WITHIN_S = 60
"""How long the cluster may be without any worker, at the start or later."""
IN_FLIGHT = 256
"""Items that the scheduler holds at least, so that workers that join later find work at once."""
_WATCH_EVERY_S = 1.0
_CONTINUES = "The same command continues where this one stopped."

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")


def in_cluster(work: Callable[[Item], Outcome], items: Iterable[Item], scheduler: str) -> Iterator[Outcome]:
    """The outcomes of `work` on all items, in the order in which they are done.

    A worker that dies is survived: the scheduler gives its item to another one.

    Args:
        scheduler: address of the Dask scheduler, such as tcp://10.0.0.1:8786.

    Raises:
        UsageError: no scheduler answers there, or it has no workers.
        UnidriveError: a machine cannot do this work, or the cluster was lost.
    """
    with _quiet(), _connected(scheduler) as client, _Watch(client) as watch:
        backend = _Backend(client=client, wait_for_workers_timeout=WORKERS_WITHIN_S)
        try:
            cores = backend.effective_n_jobs(-1)
        except TimeoutError as error:
            raise UsageError(
                f"--scheduler {scheduler}: it has had no worker for {WORKERS_WITHIN_S} seconds.",
                hint="Start some with `dask worker ADDRESS`, or wait until the batch system has started them.",
            ) from error
        _check_versions(client)
        parallel = joblib.Parallel(
            backend=backend,
            return_as="generator_unordered",
            batch_size=1,
            pre_dispatch=max(IN_FLIGHT, 2 * cores),
        )
        outcomes = parallel(joblib.delayed(_on_worker)(work, item) for item in items)
        try:
            for outcome in outcomes:  # noqa: UP028 (`yield from` would close `outcomes` with a warning)
                yield outcome
        except UnidriveError:
            raise
        except KilledWorker as error:
            raise UnidriveError(
                f"{error.allowed_failures + 1} workers died while they worked on the same sample, most likely "
                "because memory ran out or because they lack something; their logs say more.",
                hint=_CONTINUES,
            ) from error
        except Exception as error:
            if watch.lost:
                raise UnidriveError(
                    f"the cluster has had no worker for {WORKERS_WITHIN_S} seconds.",
                    hint=f"Start workers again. {_CONTINUES}",
                ) from error
            if client.status != "running":
                raise UnidriveError(
                    f"the connection to the scheduler {scheduler} was lost.", hint=_CONTINUES
                ) from error
            raise
        finally:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that work is left when nobody asks on
                outcomes.close()


class _Backend(DaskDistributedBackend):  # type: ignore[misc]
    """joblib's own, with three gaps closed.

    Work for a single core goes to that core, not to this process. What fails outside of the work itself
    (unpickling, a worker killed too often, a lost scheduler) ends the wait for it. And an end does not wait for
    outcomes that another thread takes meanwhile.
    """

    def effective_n_jobs(self, n_jobs: int) -> int:
        cores: int = super().effective_n_jobs(n_jobs)
        return max(2, cores)

    def submit(self, func: Any, callback: Callable[[Any], None] | None = None) -> Future[Any]:
        future: Future[Any] = super().submit(func, callback)

        def tell(done: Future[Any]) -> None:
            error = done.exception()
            if error is not None and callback is not None:
                callback(error)

        future.add_done_callback(tell)
        return future

    def abort_everything(self, ensure_ready: bool = True) -> None:
        with self.waiting_futures.lock:
            self.waiting_futures.futures.clear()
            with contextlib.suppress(queue.Empty):
                while True:
                    self.waiting_futures.queue.get_nowait()

    def retrieve_result_callback(self, out: Any) -> Any:
        if isinstance(out, BaseException):
            raise out
        return super().retrieve_result_callback(out)


class _Watch:
    """Ends the wait for a cluster that has lost all its workers, which the scheduler would wait for for ever."""

    def __init__(self, client: distributed.Client) -> None:
        self.lost = False
        self._client = client
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> _Watch:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        seen = time.monotonic()
        while not self._ended.wait(_WATCH_EVERY_S):
            try:
                if self._client.nthreads():
                    seen = time.monotonic()
            except Exception:
                return  # the scheduler is gone, which the client notices itself
            if time.monotonic() - seen > WORKERS_WITHIN_S + 2 * _WATCH_EVERY_S:
                self.lost = True
                self._client.close(timeout=5)  # cancels what waits
                return


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silences the libraries' log of what is said in sentences here."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in ("distributed", "tornado")]
    levels = {name: logging.getLogger(name).level for name in names}
    try:
        for name in names:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


@contextlib.contextmanager
def _connected(scheduler: str) -> Iterator[distributed.Client]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # other versions of libraries; what matters is compared by the workers
            client = distributed.Client(scheduler, timeout=CONNECT_WITHIN_S, set_as_default=False)
    except (OSError, ValueError, AssertionError) as error:  # the last: its thread did not start in time
        raise UsageError(
            f"--scheduler {scheduler}: no Dask scheduler answered there within {CONNECT_WITHIN_S} seconds.",
            hint="`dask scheduler` starts one and prints its address.",
        ) from error
    try:
        yield client
    finally:
        with contextlib.suppress(Exception):
            client.close(timeout=5)


def _check_versions(client: distributed.Client) -> None:
    """Refuses machines whose unidrive is missing or another one: they could not even read their work."""

    def version_here() -> str:  # a local function travels as it is, so it runs where unidrive is missing
        try:
            import joblib  # noqa: F401

            from unidrive_cli import __version__
        except ImportError as error:
            return f"none ({error})"
        return __version__

    found = {"the scheduler": client.run_on_scheduler(version_here)}
    found.update((f"the worker {address}", version) for address, version in client.run(version_here).items())
    for place, version in found.items():
        if version != __version__:
            raise UnidriveError(
                f"unidrive {__version__} is needed on all machines of the cluster; {place} has {version}.",
                hint="Install the same version there, with its extra `dask`.",
            )


def _on_worker(work: Callable[[Item], Outcome], item: Item) -> Outcome:
    worker = distributed.get_worker()
    if worker.state.nthreads != 1:
        raise UnidriveError(
            f"the Dask worker {worker.address} has {worker.state.nthreads} threads; one was expected.",
            hint="Start workers with `dask worker ADDRESS --nworkers N --nthreads 1`.",
        )
    return work(item)
