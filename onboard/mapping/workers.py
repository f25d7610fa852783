"""A share of numba kernels that release the interpreter's lock, on a few threads."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

_CHUNKS_PER_THREAD = 4


class Workers:
    """Runs a kernel over ranges of its rows; the caller's thread works too."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._pool = ThreadPoolExecutor(threads - 1, "map") if threads > 1 else None

    def share(self, count: int, kernel: Callable[[int, int], None]) -> None:
        """Call `kernel(first, last)` for ranges that make up 0..count - 1, in any order and at the same time.

        The kernel's result must not depend on either.
        """
        if self._pool is None:
            kernel(0, count)
            return
        step = max(1, -(-count // (_CHUNKS_PER_THREAD * self.threads)))
        chunks = iter(range(0, count, step))  # taken one by one: rays differ in length

        def work() -> None:
            _drain(chunks, step, count, kernel)

        others = [self._pool.submit(work) for _ in range(self.threads - 1)]
        work()
        for other in others:
            other.result()


def _drain(chunks: Iterator[int], step: int, count: int, kernel: Callable[[int, int], None]) -> None:
    for first in chunks:
        kernel(first, min(first + step, count))
