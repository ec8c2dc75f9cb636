"""Work on several threads: large maps by bands of rows or one by one, and generators at once.

NumPy, OpenCV and compiled loops let others run.

A band's intermediate maps stay in the processor's cache, where those of a whole picture would be written to
fresh memory and read from it.
"""

from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

from endolab.numerics.iteration import finish
from endolab.numerics.threads import limit_threads, threads

WORTH_THREADS = 300_000  # pixels; with fewer, threads cost more than they bring

Item = TypeVar("Item")
Found = TypeVar("Found")


def side_by_side(
    function: Callable[[Item], Found], items: Iterable[Item], pixels: int
) -> list[Found]:
    """Map a function, on threads if it is about so many pixels that it pays; the first error is raised."""
    wanted = list(items)
    count = min(threads(), len(wanted))
    if pixels < WORTH_THREADS or count <= 1:
        return [function(item) for item in wanted]
    contexts = [copy_context() for _ in wanted]
    with ThreadPoolExecutor(count) as pool:
        return list(
            pool.map(lambda context, item: context.run(function, item), contexts, wanted)
        )


def by_rows(function: Callable[[slice], object], shape: tuple[int, ...]) -> None:
    """Let a function do its work on bands of rows of maps of a shape, (H, W, ...); one band if it is small.

    What it writes to a band must not depend on others.
    """
    rows, columns = shape[:2]
    if rows * columns < WORTH_THREADS:
        function(slice(0, rows))
        return
    # With 30 000 pixels a map of 8 bytes each and a few more like it fit the cache.
    step = max(1, 30_000 // columns)
    bands = [slice(i, min(i + step, rows)) for i in range(0, rows, step)]
    side_by_side(function, bands, rows * columns)


def run_together(
    generators: Sequence[Generator[Item, None, Found]],
) -> list[Generator[Item, None, Found]]:
    """Run generators at once, a core each; return generators that yield and return what these did."""

    def record(steps: Generator[Item, None, Found]) -> tuple[list[Item], Found]:
        items: list[Item] = []
        return items, finish(steps, items.append)

    def replay(
        doing: Future[tuple[list[Item], Found]],
    ) -> Generator[Item, None, Found]:
        items, found = doing.result()
        yield from items
        return found

    if threads() == 1 or not generators:
        return list(generators)
    pool = ThreadPoolExecutor(len(generators))
    with limit_threads(1):
        begun = [pool.submit(copy_context().run, record, steps) for steps in generators]
    pool.shutdown(wait=False)
    return [replay(doing) for doing in begun]
