"""
The viewer's server as a process, with a source that obeys its standard input.

Arguments: port, token ('' for none), pictures per second. Lines on the input: `stop` and `go`
for the pictures; a JSON object for fields of the state.
"""
from dataclasses import replace
import json
import sys
import threading
import time

from neo_ros.viewer.hub import Hub
from neo_ros.viewer.pictures import SourcePicture, SourceState
from neo_ros.viewer.server import serve
from neo_ros.viewer.settings import ViewerSettings
import numpy as np

HEIGHT, WIDTH = 96, 128
SEEN = (0.25, 0.25, 0.5, 0.5)
RING, INSIDE = (0, 160, 0), (200, 0, 0)


class ObedientSource:
    """Green around red; a white spot moves along the lower edge; unsure on the left."""

    def __init__(self, rate: float) -> None:
        self._period = 1 / rate
        self._going = threading.Event()
        self._going.set()
        self._state = SourceState('/camera/wide/image', node_ms=12.0)

    def obey(self) -> None:
        """Read commands until the input ends."""
        for line in sys.stdin:
            if line.startswith('{'):
                self._state = replace(self._state, **json.loads(line))
            elif line.strip() == 'stop':
                self._going.clear()
            else:
                self._going.set()

    def run(self, hub: Hub, stop: threading.Event) -> None:
        """Publish until stopped."""
        confidence = np.full((HEIGHT, WIDTH), 255, np.uint8)
        confidence[:, :WIDTH // 2] = 0
        count = 0
        while not stop.wait(self._period):
            hub.report(self._state)
            if self._going.is_set():
                image = np.full((HEIGHT, WIDTH, 3), RING, np.uint8)
                image[HEIGHT // 4:-HEIGHT // 4, WIDTH // 4:-WIDTH // 4] = INSIDE
                spot = 8 * (count % (WIDTH // 8))
                image[-8:, spot:spot + 8] = 255
                span = self._state.span
                hub.publish(SourcePicture(image, time.monotonic(), True, confidence, SEEN,
                                          span and span[0] + count * self._period))
                count += 1


def main() -> None:
    """Serve until a signal comes."""
    port, token, rate = int(sys.argv[1]), sys.argv[2], float(sys.argv[3])
    source = ObedientSource(rate)
    threading.Thread(target=source.obey, daemon=True).start()
    serve(source, ViewerSettings(port=port, token=token, quality=95),
          lambda line: print(line, flush=True))


if __name__ == '__main__':
    main()
