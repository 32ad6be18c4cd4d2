"""Work on the logs of a set side by side, in processes of their own, with a line that tells how far it is."""

import multiprocessing
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any


def side_by_side(work: Callable[..., Any], jobs: Mapping[str, tuple], processes: int, done: str = '',
                 fresh: bool = False) -> Iterator[tuple[str, Any]]:
    """Name and ``work(*job)`` of each of the ``jobs``, as they end.

    ``done``: what has become of a log, for the line on stderr; empty: no line.  ``fresh``: a new process for each.
    A job that fails does not keep the others from their end; then its error is raised, with its name.
    """
    context = multiprocessing.get_context('forkserver')
    context.set_forkserver_preload([work.__module__])
    failed: list[Exception] = []
    with ProcessPoolExecutor(processes, mp_context=context, max_tasks_per_child=1 if fresh else None) as pool:
        running = {pool.submit(work, *job): name for name, job in jobs.items()}
        for count, future in enumerate(as_completed(running), 1):
            error = future.exception()
            if error is not None:
                error.add_note(f'while working on {running[future]}')
                failed.append(error)
            if done:
                lost = f', {len(failed)} failed' if failed else ''
                print(f'\r{done} {count - len(failed)} of {len(jobs)}{lost}', end='', file=sys.stderr, flush=True)
            if error is None:
                yield running[future], future.result()
    if done:
        print(file=sys.stderr)
    if failed:
        raise failed[0]
