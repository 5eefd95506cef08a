"""Work on a real Dask cluster of this machine: what comes back, and what is said when something is missing."""

from __future__ import annotations

import operator
import os
import signal
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("distributed", reason="the extra `dask` is not installed")

import distributed

from tests.clusters import Cluster, cluster
from unidrive_cli import __version__
from unidrive_cli import cluster as room
from unidrive_cli.cluster import in_cluster
from unidrive_cli.errors import UnidriveError, UsageError


@pytest.fixture
def bare(tmp_path: Path) -> Iterator[Cluster]:
    """A scheduler without workers."""
    with cluster(tmp_path) as made:
        yield made


def test_every_item_once_and_never_many_at_a_time(bare: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "IN_FLIGHT", 8)
    bare.start_worker()
    bare.start_worker()
    pulled, done = [], []

    def items() -> Iterator[int]:
        for item in range(100):
            pulled.append(item)
            yield item

    for outcome in in_cluster(operator.neg, items(), bare.address):
        done.append(outcome)
        assert len(pulled) - len(done) <= 3 * 8  # what waits, and what is done and not asked for yet
    assert sorted(done) == sorted(-item for item in range(100))


def test_the_only_worker_does_the_work_not_this_process(bare: Cluster) -> None:
    worker = bare.start_worker()
    assert set(in_cluster(os.getpgid, [0, 0, 0], bare.address)) == {worker.pid}


def test_a_worker_that_joins_later_works_too(bare: Cluster) -> None:
    workers = {bare.start_worker().pid}
    seen = set()
    for group in in_cluster(os.getpgid, (0 for _ in range(5000)), bare.address):
        if not seen:
            workers.add(bare.start_worker().pid)
        seen.add(group)
        if seen == workers:
            break
    assert seen == workers


def test_work_that_kills_its_workers_is_given_up(bare: Cluster) -> None:
    """Dask tries an item on four workers; the nanny starts each dead one anew."""
    bare.start_worker("--nworkers", "2", "--nthreads", "1")
    with pytest.raises(UnidriveError, match="4 workers died while they worked on the same sample"):
        list(in_cluster(os._exit, [3], bare.address))


def test_a_cluster_that_loses_all_workers_is_given_up(bare: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "WORKERS_WITHIN_S", 5)
    worker = bare.start_worker()
    outcomes = in_cluster(os.getpgid, (0 for _ in range(100_000)), bare.address)
    next(outcomes)
    os.killpg(worker.pid, signal.SIGKILL)
    with pytest.raises(UnidriveError, match=r"no worker for 5 seconds\. Start workers again\. The same command"):
        list(outcomes)


def test_an_end_does_not_wait_for_what_another_thread_took_meanwhile(
    bare: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Seen once: the queue was not empty, then it was, and the end waited for ever."""
    with distributed.Client(bare.address, set_as_default=False) as client:
        backend = room._Backend(client=client)
        monkeypatch.setattr(backend.waiting_futures.queue, "empty", lambda: False)
        ending = threading.Thread(target=backend.abort_everything, daemon=True)
        ending.start()
        ending.join(20)
        assert not ending.is_alive()


def test_a_scheduler_that_dies_ends_the_work(bare: Cluster) -> None:
    bare.start_worker()
    outcomes = in_cluster(os.getpgid, (0 for _ in range(100_000)), bare.address)
    next(outcomes)
    os.killpg(bare.scheduler.pid, signal.SIGKILL)
    with pytest.raises(UnidriveError, match=f"the connection to the scheduler {bare.address} was lost"):
        list(outcomes)


def test_no_scheduler_is_there(bare: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "CONNECT_WITHIN_S", 1)
    bare.close()
    with pytest.raises(UsageError, match=f"--scheduler {bare.address}: no Dask scheduler answered there within 1 "):
        list(in_cluster(operator.neg, [1], bare.address))


@pytest.mark.parametrize("address", ["carrier-pigeon://a:1", "tcp://127.0.0.1:99999999", "tcp://nowhere.invalid:1"])
def test_an_address_that_is_none(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "CONNECT_WITHIN_S", 1)
    with pytest.raises(UsageError, match=f"--scheduler {address}: "):
        list(in_cluster(operator.neg, [1], address))


def test_a_machine_too_busy_to_start_the_client(monkeypatch: pytest.MonkeyPatch) -> None:
    """distributed asserts that its thread started within ten seconds; seen on a machine that stood still."""

    def start(self: distributed.utils.LoopRunner) -> None:
        raise AssertionError

    monkeypatch.setattr(distributed.utils.LoopRunner, "start", start)
    with pytest.raises(UsageError, match="no Dask scheduler answered there within"):
        list(in_cluster(operator.neg, [1], "tcp://127.0.0.1:1"))


def test_a_scheduler_without_workers(bare: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "WORKERS_WITHIN_S", 1)
    with pytest.raises(UsageError, match="it has had no worker for 1 seconds"):
        list(in_cluster(operator.neg, [1], bare.address))


def test_a_worker_with_threads_is_refused(bare: Cluster) -> None:
    bare.start_worker("--nthreads", "2", "--no-nanny")
    with pytest.raises(UnidriveError, match=r"has 2 threads; one was expected\. .*--nthreads 1"):
        list(in_cluster(operator.neg, [1], bare.address))


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("__version__ = '0.0.1'", r"0\.0\.1"),
        ("raise ImportError('no unidrive here')", r"none \(no unidrive here\)"),
    ],
    ids=["another version", "none"],
)
def test_a_machine_with_another_unidrive_is_refused(bare: Cluster, tmp_path: Path, text: str, found: str) -> None:
    package = tmp_path / "other" / "unidrive_cli"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(text)
    bare.start_worker(first_in_path=package.parent)
    sentence = rf"unidrive {__version__} is needed on all machines of the cluster; the worker \S+ has {found}\."
    with pytest.raises(UnidriveError, match=sentence):
        list(in_cluster(operator.neg, [1], bare.address))


def test_workers_are_free_again_when_nobody_asks_on(bare: Cluster) -> None:
    worker = bare.start_worker()
    outcomes = in_cluster(os.getpgid, (0 for _ in range(100_000)), bare.address)
    next(outcomes)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        outcomes.close()  # type: ignore[attr-defined]
    assert set(in_cluster(os.getpgid, [0], bare.address)) == {worker.pid}
