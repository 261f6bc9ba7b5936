"""What a benchmark on a borrowed machine has to leave before the machine is given back."""
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
import signal
import tarfile
from typing import Any

from neo_ros.machine.files import make_output_folder, write_bytes

PART_BYTES = 15_000_000
# Below the working folder; fields and features can be made again and stay behind.
KEPT = ('*.md', '*.html', '*/*.json', '*/*/*.json', '*/*/*.onnx', '*/*/*.memory')


@contextmanager
def bundled(folder: Path, rows_file: Path, work: Path) -> Iterator[None]:
    """
    Write the bundle however the work inside ends, also where the process is told to terminate.

    That is what a machine says that is taken back. The exit code is the one of the signal.
    """
    def leave(number: int, frame: object) -> None:
        # Told again while the bundle is written: there is nothing better to do.
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        write_bundle(folder, rows_file, work)
        signal.signal(signal.SIGTERM, before)


def write_bundle(folder: Path, rows_file: Path, work: Path) -> list[Path]:
    """
    Put rows, tables, page, models and memories into one archive, cut into files below 16 MB.

    Returns the files; `cat FOLDER/*.tar.* | tar x` unpacks them. Those of an earlier call are
    replaced. Raises NeoError where they cannot be written.
    """
    name = rows_file.stem
    make_output_folder(folder)
    for old in folder.glob(f'{name}.tar.*'):
        old.unlink()
    parts: list[Path] = []

    def write_part(content: bytes) -> None:
        parts.append(folder / f'{name}.tar.{len(parts):02d}')
        write_bytes(parts[-1], content)

    cut = _Cut(write_part)
    with tarfile.open(fileobj=cut, mode='w|') as archive:  # type: ignore[call-overload]
        if rows_file.exists():
            archive.add(rows_file, rows_file.name)
        for path in sorted({path for pattern in KEPT for path in work.glob(pattern)}):
            archive.add(path, str(path.relative_to(work)))
    cut.flush()
    return parts


class _Cut:
    """A file to be written to that hands its content on in parts."""

    def __init__(self, write_part: Callable[[bytes], Any]) -> None:
        self.write_part, self.waiting = write_part, bytearray()

    def write(self, content: bytes) -> int:
        self.waiting += content
        while len(self.waiting) >= PART_BYTES:
            self.write_part(bytes(self.waiting[:PART_BYTES]))
            del self.waiting[:PART_BYTES]
        return len(content)

    def flush(self) -> None:
        if self.waiting:
            self.write_part(bytes(self.waiting))
            self.waiting.clear()
