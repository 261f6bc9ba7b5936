"""What became of many bags: a table, bags.json and report.html."""
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
import json
from pathlib import Path
from typing import Any

from neo_ros.machine.files import write_bytes
from neo_ros.reports.report import Section, Table, Text, write_report

SUMMARY_FILE, REPORT_FILE = 'bags.json', 'report.html'


@dataclass(frozen=True)
class ReplayedBag:
    """
    What became of one of many bags.

    source       the bag that was replayed
    guided       frames that the scene memory guided; None without one
    scored       how many frames; ring_psnr is their mean, in dB, None for none
    truth_topic  the wide images they were scored against; None: the camera's own border
    rejected     how many messages, by reason
    lost         messages that could not be read; None where nobody knows how many there were
    assumed      what its camera was taken for, where no camera_info says it
    error        why there is no new bag; empty where there is one
    """

    name: str
    source: str
    frames: int = 0
    guided: int | None = None
    scored: int = 0
    ring_psnr: float | None = None
    truth_topic: str | None = None
    rejected: dict[str, int] = field(default_factory=dict)
    lost: int | None = 0
    damages: list[str] = field(default_factory=list)
    assumed: str = ''
    error: str = ''

    @property
    def scored_against(self) -> str:
        """What its frames were scored against; empty for nothing."""
        return '' if not self.scored else self.truth_topic or 'its own border'


def summary_of(rows: Sequence[ReplayedBag]) -> dict[str, Any]:
    """
    Return what holds for all bags together.

    `ring_psnr` is the mean over all scored frames; None where some bags were scored against
    truth and others against themselves, which does not compare.
    """
    known = [row for row in rows if row.guided is not None]
    scored = [row for row in rows if row.ring_psnr is not None]
    frames = sum(row.scored for row in scored)
    alike = len({row.truth_topic is None for row in scored}) == 1
    return {'bags': len(rows), 'failed': sum(bool(row.error) for row in rows),
            'frames': sum(row.frames for row in rows),
            'guided': sum(row.guided or 0 for row in known) if known else None,
            'scored': frames,
            'ring_psnr': sum((row.ring_psnr or 0) * row.scored for row in scored) / frames
            if alike else None}


def summary_table(rows: Sequence[ReplayedBag]) -> tuple[list[str], list[list[str]]]:
    """Return the columns and the lines of a table of the bags; the last line is of all."""
    columns = ['bag', 'frames', 'guided', 'ring PSNR, dB', 'scored against', 'rejected',
               'messages lost']
    lines = [[row.name, 'failed' if row.error else str(row.frames),
              _share(row.guided, row.frames), _decibels(row.ring_psnr), row.scored_against,
              ', '.join(f'{count} {reason}' for reason, count in row.rejected.items()),
              'unknown' if row.lost is None else str(row.lost or '')] for row in rows]
    both = summary_of(rows)
    done = both['bags'] - both['failed']
    lines.append([f'{done} of {both["bags"]} bags', str(both['frames']),
                  _share(both['guided'], both['frames']), _decibels(both['ring_psnr']),
                  '', str(sum(sum(row.rejected.values()) for row in rows) or ''),
                  str(sum(row.lost or 0 for row in rows) or '')])
    # A model without a memory guides nothing, and without --score there are no scores.
    kept = [place for place in range(len(columns)) if any(line[place] for line in lines)]
    return [columns[place] for place in kept], [[line[place] for place in kept] for line in lines]


def write_summary(folder: Path, rows: Sequence[ReplayedBag], about: dict[str, Any]) -> None:
    """
    Write bags.json and report.html into the folder.

    about  the model, for the top of both
    Raises NeoError when a file cannot be written.
    """
    write_bytes(folder / SUMMARY_FILE, (json.dumps(
        {**about, 'all': summary_of(rows), 'bags': [asdict(row) for row in rows]},
        indent=1) + '\n').encode())
    columns, lines = summary_table(rows)
    facts = ', '.join(f'{key.replace("_", " ")} {value}' for key, value in about.items())
    sections: list[Section] = [
        Text(f'{facts}.'),
        Table(columns, lines, 'Bags', 'Each has a folder of its own, with its scores where it was '
              'scored. The ring is what the model made up.', strong_row=len(rows))]
    failed = [f'{row.name}: {row.error}' for row in rows if row.error]
    damages = [f'{row.name}: {damage}' for row in rows for damage in row.damages]
    assumed = [f'{row.name}: {row.assumed}' for row in rows if row.assumed]
    for title, told in (('Failed', failed), ('Damaged', damages), ('Assumed', assumed)):
        if told:
            sections.append(Text('\n'.join(told), title))
    write_report(folder / REPORT_FILE, f'{len(rows)} bags, widened', sections)


def _share(part: int | None, whole: int) -> str:
    return '' if part is None or not whole else f'{part / whole:.0%}'


def _decibels(value: float | None) -> str:
    return '' if value is None else f'{value:.2f}'
