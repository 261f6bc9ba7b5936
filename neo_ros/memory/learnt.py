"""A scene memory as it is shown now: what was learnt since it was made is in it."""
from pathlib import Path

from neo_ros.memory.changes import Changes
from neo_ros.memory.journal import journal_path, read_journal
from neo_ros.memory.scene_memory import SceneMemory


def read_learnt(path: Path, sha256: str) -> SceneMemory:
    """
    Read a memory, and what the journal beside it holds now.

    Raises ModelError as `SceneMemory.read`; a journal that cannot be used is left aside.
    """
    memory = SceneMemory.read(path, sha256)
    if records := read_journal(journal_path(path), sha256):
        memory.change(Changes(records))
    return memory
