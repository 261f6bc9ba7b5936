"""Rows of results that take long to measure: kept one by one, and not measured twice."""
from collections.abc import Mapping
import json
from pathlib import Path
from typing import Any

from neo_ros.machine.files import write_bytes
from neo_ros.machine.host import commit, host


class ResultRows:
    """The rows of a JSON file, which need not be there yet."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: list[dict[str, Any]] = json.loads(path.read_text()) if path.exists() else []

    def find(self, key: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return the row with these values; None where it is still to be measured."""
        return next((row for row in self.rows if key.items() <= row.items()), None)

    def add(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Write one more row, with the commit and, unless it names it, the host; return it."""
        self.rows.append({'host': host(), **row, 'commit': commit()})
        write_bytes(self.path, (json.dumps(self.rows, indent=1) + '\n').encode())
        return self.rows[-1]
