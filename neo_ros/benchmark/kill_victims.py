"""
A camera that learns until it is killed: what `benchmark/kills.py` starts and kills.

    python -m neo_ros.benchmark.kill_victims MODEL X Y ROUNDS LEARN

Says in one line of JSON what it finds in the journal. Then it drives through the small room, past
a post at X, Y, ROUNDS times, learns as LEARN says (beside, at once), and says how far it has come;
0: it only tells whether the memory knows any image.
"""
from collections.abc import Sequence
import json
import logging
from pathlib import Path
import sys
import time
import zlib

from neo_ros.benchmark.small_room import drive, look, WIDE
from neo_ros.memory.journal import journal_path, read_journal
from neo_ros.memory.learning import Learn, logger, LOOKED
from neo_ros.memory.turn import Record
from neo_ros.runtime import FovExtrapolator
from neo_ros.runtime.fov_extrapolator import memory_path
from neo_ros.runtime.model_card import read_model_card
import numpy as np

HZ = 30.0  # of the camera


def marks(records: Sequence[Record]) -> list[int]:
    """Return what tells records of a journal from each other."""
    return [zlib.crc32(record.to_bytes()) for record in records]


def journal_of(model: Path) -> tuple[Path, str]:
    """Return the journal of a model, and the checksum of the memory that it belongs to."""
    memory = read_model_card(model).memory
    assert memory is not None
    return journal_path(memory_path(model, memory)), memory.sha256


class TellLooked(logging.Handler):
    """Says up to which image all was looked at, and is on the disk."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print the stamp."""
        if record.msg == LOOKED and isinstance(record.args, tuple):
            print(json.dumps({'looked': record.args[1]}), flush=True)


def live(model: Path, post: tuple[float, float], rounds: int, learn: Learn) -> None:
    """Load the model with what was learnt, tell of it, and go on learning."""
    journal = journal_of(model)
    extrapolator = FovExtrapolator.load(model, learn=learn if rounds else 'never')
    images = [np.ascontiguousarray(look(pose, WIDE.source, post)[0]) for pose in drive()]
    patches = read_journal(*journal)
    guided = not rounds and any(extrapolator.expand(image).guided for image in images)
    print(json.dumps({'records': marks(patches), 'guided': guided,
                      'last': max((one.stamp_ns for one in patches), default=0)}), flush=True)
    if not rounds:
        return
    print(json.dumps({'looked': time.time_ns()}), flush=True)
    logger.setLevel(logging.DEBUG)
    logger.addHandler(TellLooked())
    began = time.monotonic()
    for number in range(rounds * len(images)):
        # There and back: the camera never jumps.
        place = number % (2 * len(images))
        extrapolator.expand(images[min(place, 2 * len(images) - 1 - place)])
        time.sleep(max(0.0, began + (number + 1) / HZ - time.monotonic()))
    extrapolator.finish_learning()


if __name__ == '__main__':
    live(Path(sys.argv[1]), (float(sys.argv[2]), float(sys.argv[3])), int(sys.argv[4]),
         'beside' if sys.argv[5] == 'beside' else 'at once')
