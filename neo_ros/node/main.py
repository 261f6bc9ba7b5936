"""The executable `fov_extrapolator`; light, so that signals are handled before all else loads."""
from collections.abc import Sequence
import os
import signal

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the node until SIGINT, SIGTERM or a shutdown of its context."""
    for number in SIGNALS:
        # Raising in the middle of an import ends in a traceback of somebody else's module.
        signal.signal(number, lambda *_: os._exit(0))
    # scripts/fov_extrapolator blocks them until here.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    from neo_ros.node.running import run
    run(arguments)


if __name__ == '__main__':
    main()
