"""What a scene memory warns of, in ROS's log and for the diagnosis."""
from collections.abc import Callable
import logging


class MemoryWarnings(logging.Handler):
    """
    Takes the warnings of this package's Python loggers: of learning, its journal, its lights.

    report: gets each new one, from any thread. last: the last one, '' = none.
    """

    def __init__(self, report: Callable[[str], None]) -> None:
        super().__init__(logging.WARNING)
        self.last = ''
        self._report = report
        self._logger = logging.getLogger('neo_ros')
        self._logger.addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Keep it; what is said again and again is reported once."""
        words = record.getMessage()
        if words != self.last:
            self.last = words
            self._report(words)

    def forget(self) -> None:
        """Begin anew: another model."""
        self.last = ''

    def close(self) -> None:
        """Hear no more."""
        self._logger.removeHandler(self)
        super().close()
