"""Names in the order that people expect, and in messages."""
from collections.abc import Sequence
import re


def natural_key(name: str) -> list[tuple[int, str]]:
    """Sort key by which digits count as numbers."""
    return [(int(part), '') if part.isdecimal() else (-1, part)
            for part in re.split(r'(\d+)', name)]


def listed(names: Sequence[object], most: int = 5) -> str:
    """Name the first few of many for a message."""
    shown = ', '.join(str(name) for name in names[:most])
    return shown + (f' and {len(names) - most} more' if len(names) > most else '')
