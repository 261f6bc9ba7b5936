"""Which files a bag consists of, and what its metadata.yaml says about them."""
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
import os
from pathlib import Path
import shutil
import tempfile
from typing import Any

from neo_ros.errors import BagError
from neo_ros.machine.names import natural_key
import yaml
import zstandard

MCAP, SQLITE, PACKED = '.mcap', '.db3', '.zstd'
# Packed ones first: where a file is there in both ways, the later one counts.
STORAGE_SUFFIXES = (MCAP + PACKED, MCAP, SQLITE + PACKED, SQLITE)
# Unpacked files may fill the disk up to this.
_KEEP_FREE_BYTES = 1 << 30
_BLOCK = 1 << 20


@dataclass(frozen=True)
class BagFolder:
    """
    The storage files of a bag in their order, as they lie there.

    counts          messages by file name, as metadata.yaml says
    missing         files that metadata.yaml lists and that are not there, with their messages
    foreign         names of storage files that metadata.yaml does not list: they are not read
    topics          the entries of metadata.yaml by topic: QoS, hash of the type
    custom_data     the words that its recorder put into metadata.yaml
    """

    files: tuple[Path, ...]
    counts: dict[str, int]
    missing: dict[str, int | None]
    foreign: tuple[str, ...]
    topics: dict[str, dict[str, Any]]
    custom_data: dict[str, str]


def read_bag_folder(path: Path) -> BagFolder:
    """
    Look at a bag folder or a bare file.

    metadata.yaml is optional, and where it cannot be read it is passed over. Raises BagError
    when there is no storage file.
    """
    if not path.exists():
        raise BagError(f'{path}: no such bag')
    metadata = _read_metadata(path / 'metadata.yaml')
    listed = metadata.get('relative_file_paths')
    names = [plain_name(name) for name in listed] if isinstance(listed, list) else []
    files, foreign = _storage_files(path, names)
    present = {plain_name(file.name) for file in files}
    counts = {plain_name(entry.get('path')): count for entry in _dicts(metadata.get('files'))
              if isinstance(count := entry.get('message_count'), int)}
    total = metadata.get('message_count')
    if not counts and len(names) == 1 and isinstance(total, int):
        counts = {names[0]: total}
    missing = {name: counts.get(name) for name in names if name not in present}
    topics = {str(entry.get('name')): entry for entry in _dicts([
        item.get('topic_metadata') for item in _dicts(
            metadata.get('topics_with_message_count'))])}
    custom = metadata.get('custom_data')
    words = {str(key): str(value) for key, value in custom.items()} if isinstance(
        custom, dict) else {}
    return BagFolder(tuple(files), counts, missing, tuple(foreign), topics, words)


def find_storage_files(folder: Path) -> list[Path]:
    """Return the storage files of a folder; macOS adds a hidden ._drive.mcap to drive.mcap."""
    return [file for suffix in STORAGE_SUFFIXES for file in folder.glob(f'*{suffix}')
            if not file.name.startswith('.')]


def _read_metadata(path: Path) -> dict[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
        found = content['rosbag2_bagfile_information']
        return found if isinstance(found, dict) else {}
    except (OSError, ValueError, yaml.YAMLError, KeyError, TypeError):
        return {}


def plain_name(name: Any) -> str:
    """Return the name of a storage file when it is unpacked."""
    return Path(str(name)).name.removesuffix(PACKED)


def bag_name(bag: Path) -> str:
    """Return the name of a bag folder, or that of a bare file without its endings."""
    if bag.is_dir():
        return bag.name
    return plain_name(bag.name).removesuffix(MCAP).removesuffix(SQLITE)


def _dicts(value: Any) -> list[dict[str, Any]]:
    return [entry for entry in value if isinstance(entry, dict)] if isinstance(
        value, list) else []


def _storage_files(path: Path, listed: Sequence[str]) -> tuple[list[Path], list[str]]:
    """
    Return the files of a bag in their order, and the names of those that are not of it.

    listed: the names in metadata.yaml. Where none of them is there, all files are of the bag: a
    recovered copy beside the file that it was made of would double all messages.
    """
    if path.is_file():
        if not path.name.endswith(STORAGE_SUFFIXES):
            advice = ('; a ROS 1 bag is read after rosbags-convert' if path.suffix == '.bag'
                      else '')
            raise BagError(
                f'{path}: expected a bag folder, a {MCAP} or a {SQLITE} file{advice}')
        return [path], []
    found = find_storage_files(path)
    own = [file for file in found if plain_name(file.name) in listed]
    foreign = sorted({file.name for file in found} - {file.name for file in own}) if own else []
    for kind in (MCAP, SQLITE):
        # A recorder that was killed leaves packed files, and one that is not packed yet, or
        # only in part.
        files = {name: file for file in own or found
                 if (name := plain_name(file.name)).endswith(kind)}
        if files:
            # bag_2.mcap comes before bag_10.mcap.
            return [files[name] for name in sorted(files, key=natural_key)], foreign
    raise BagError(f'{path}: expected a rosbag2 folder, there is no {MCAP} or {SQLITE} in it')


def unpacked(file: Path, stack: ExitStack) -> Path:
    """
    Unpack a .zstd file as far as it goes; another one is returned as it is.

    What is unpacked is gone when `stack` is closed. Raises BagError where it does not fit on the
    disk or cannot be read.
    """
    if file.suffix != PACKED:
        return file
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix='neo_ros_bag_')))
    target = folder / file.stem
    room = shutil.disk_usage(folder).free - _KEEP_FREE_BYTES
    try:
        with file.open('rb') as packed, target.open('wb') as content:
            reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
            while block := reader.read(_BLOCK):
                room -= len(block)
                if room < 0:
                    content.truncate(0)
                    raise BagError(f'{file}: unpacked it does not fit on the disk of '
                                   f'{tempfile.gettempdir()}; set TMPDIR to a larger one')
                content.write(block)
    except zstandard.ZstdError:
        pass  # Cut off or damaged: what came out so far is read like a file that was cut off.
    except OSError as error:
        raise BagError(f'{file}: cannot unpack it: {os.strerror(error.errno or 0)}') from error
    return target
