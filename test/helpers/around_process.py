"""
The viewer's server as a process, for a camera in the box room.

Arguments: the folder for the model, or '' to go without one. Lines on the input: JSON objects
with `x`, `y`, `yaw` (degrees) of the camera; `lost`, whether its place is known; `late`, seconds
by which everything comes late; `torn`, whether its images cannot be read.
"""
from functools import partial
import json
from pathlib import Path
import sys
import threading
import time
from typing import Any

from box_room import EXPANSION, planar, view, write_box_model
from neo_ros.errors import NeoError
from neo_ros.viewer.hub import Hub
from neo_ros.viewer.pictures import SourcePicture, SourceState
from neo_ros.viewer.server import serve
from neo_ros.viewer.settings import ViewerSettings
from neo_ros.viewer.whereabouts import Place
import numpy as np

START = {'x': 1.9, 'y': 1.7, 'yaw': 30.0, 'lost': False, 'late': 0.0, 'torn': False}
PERIOD_S = 0.1


def unreadable() -> np.ndarray:
    """Fail as a damaged file does."""
    raise NeoError('image 7: damaged')


class BoxSource:
    """Shows the room as it is, at 10 Hz."""

    def __init__(self) -> None:
        self._now: dict[str, Any] = dict(START)

    def obey(self) -> None:
        """Read commands until the input ends."""
        for line in sys.stdin:
            self._now = self._now | json.loads(line)

    def run(self, hub: Hub, stop: threading.Event) -> None:
        """Publish until stopped."""
        hub.report(SourceState('/camera/wide/image'))
        while not stop.wait(PERIOD_S):
            now = self._now
            pose = planar(now['x'], now['y'], now['yaw'])
            image, _ = view(pose, EXPANSION.target)
            captured = time.monotonic() - now['late']
            if not now['lost']:
                hub.where.put(Place(pose, captured, unreadable if now['torn']
                                    else partial(np.asarray, image)))
            hub.publish(SourcePicture(image, captured, True, None, (0.25, 0.25, 0.5, 0.5)))


def main() -> None:
    """Serve until a signal comes."""
    model = write_box_model(Path(sys.argv[1])) if sys.argv[1] else None
    source = BoxSource()
    threading.Thread(target=source.obey, daemon=True).start()
    serve(source, ViewerSettings(port=0, quality=95, model=model, stale_after=60.0),
          lambda line: print(line, flush=True))


if __name__ == '__main__':
    main()
