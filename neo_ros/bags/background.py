"""Read ahead and write behind in threads, so that the work in between does not wait."""
from collections.abc import Callable, Generator, Iterable
from queue import Full, Queue
import threading
from types import TracebackType
from typing import Any, TypeVar

Item = TypeVar('Item')
# Enough for the messages between two images; each may be an image itself.
DEPTH = 32
_LOOK_S = 0.05


def read_ahead(items: Iterable[Item], depth: int = DEPTH) -> Generator[Item]:
    """Yield the items, which another thread takes from their source; its errors come here."""
    waiting: Queue[tuple[bool, Any]] = Queue(depth)
    stop = threading.Event()

    def put(entry: tuple[bool, Any]) -> bool:
        while not stop.is_set():
            try:
                waiting.put(entry, timeout=_LOOK_S)
                return True
            except Full:
                pass
        return False

    def read() -> None:
        try:
            for item in items:
                if not put((True, item)):
                    return
        except BaseException as error:  # Raised again by the one who waits.
            put((False, error))
        else:
            put((False, None))

    thread = threading.Thread(target=read, name='read ahead', daemon=True)
    thread.start()
    try:
        while True:
            more, value = waiting.get()
            if more:
                yield value
            elif value is None:
                return
            else:
                raise value
    finally:
        stop.set()
        thread.join()


class WriteBehind:
    """
    Runs calls in another thread, in their order, as a context manager.

    An error of a call is raised by the next `submit` or at the end of the `with` block, which
    waits for all calls; where the block ends with an exception, the waiting calls are dropped.
    """

    def __init__(self, depth: int = DEPTH) -> None:
        self._waiting: Queue[tuple[Callable[..., Any], tuple[Any, ...]] | None] = Queue(depth)
        self._error: BaseException | None = None
        self._dropped = threading.Event()
        self._thread = threading.Thread(target=self._run, name='write behind', daemon=True)

    def __enter__(self) -> 'WriteBehind':
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if kind is not None:
            self._dropped.set()
        self._waiting.put(None)
        self._thread.join()
        if kind is None and self._error is not None:
            raise self._error

    def submit(self, call: Callable[..., Any], *arguments: Any) -> None:
        """Run the call later; waits while too many are waiting already."""
        if self._error is not None:
            raise self._error
        self._waiting.put((call, arguments))

    def _run(self) -> None:
        while (entry := self._waiting.get()) is not None:
            if self._error is not None or self._dropped.is_set():
                continue  # Whoever submits must not wait for ever.
            try:
                entry[0](*entry[1])
            except BaseException as error:
                self._error = error
