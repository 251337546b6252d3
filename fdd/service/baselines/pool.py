"""Batch tasks side by side on a pool of processes, each failure on its own.

A task is a plain function of plain data, so that another scheduler (dask's ``client.map``) could run it as it stands.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Failure:
    """A task that gave nothing, and why."""

    reason: str


def side_by_side(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    done: Callable[[int, Result | Failure], None],
    workers: int | None = None,
) -> None:
    """Run a function over tasks; ``done(index, result)`` is called here, in this process, as each one ends.

    A process that dies takes down the pool it is in; what had not ended by then is done again, each in a process of
    its own, so that only the task that killed it is lost.
    """
    workers = min(len(tasks), workers or os.cpu_count() or 1)
    if not tasks:
        return
    broken: list[int] = []
    with _pool(workers) as pool:
        waiting = {pool.submit(function, task): i for i, task in enumerate(tasks)}
        for future in as_completed(waiting):
            if isinstance(future.exception(), BrokenProcessPool):
                broken.append(waiting[future])
            else:
                outcome = _outcome(future)
                done(waiting[future], outcome)
    for i in sorted(broken):
        with _pool(1) as pool:
            outcome = _outcome(pool.submit(function, tasks[i]))
            done(i, outcome)


def _pool(workers: int) -> ProcessPoolExecutor:
    # Forking a process that runs threads (Zenoh's, the store's) may lock up its child; a fork server has none.
    return ProcessPoolExecutor(
        workers, mp_context=multiprocessing.get_context("forkserver"), initializer=_end_with_parent
    )


def _end_with_parent() -> None:
    """A worker waits for ever for the tasks of a parent that was killed: it watches for that, and ends too."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _outcome(future: Future[Result]) -> Result | Failure:
    try:
        return future.result()
    except BrokenProcessPool:
        return Failure("its process died (killed, or out of memory)")
    except Exception as error:
        return Failure(f"{type(error).__name__}: {error}")
