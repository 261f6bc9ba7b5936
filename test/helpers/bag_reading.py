"""All that is left of a bag."""
from pathlib import Path

from neo_ros.bags import BagReader, Damage
from neo_ros.errors import BagError


def read_all(path: Path) -> tuple[list[bytes], list[Damage]]:
    """Return all messages of a bag and what was lost; nothing where nothing is left of it."""
    try:
        with BagReader(path) as bag:
            found = [message.cdr for message in bag.messages()]
            return found, bag.damages
    except BagError as error:
        assert 'nothing could be recovered' in str(error)
        return [], []
