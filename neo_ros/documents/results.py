"""Tables of docs/results/ from the files in results/."""
from collections.abc import Callable, Iterable, Mapping
import json
import math
from pathlib import Path
from typing import Any

from neo_ros.benchmark.paper_figures import PAPER, PAPER_SCENES
from neo_ros.documents.pages import Maker, table
from neo_ros.documents.tables import MEASURES, Row, TABLES, TRAINED
from neo_ros.errors import NeoError


def rows_of(root: Path, file: str) -> list[Row]:
    """Return the rows of a file in results/, whatever else it holds."""
    content = _read(root, file)
    if isinstance(content, list):
        return content
    return content.get('rows') or content.get('records') or [content]


def sources(root: Path, *names: str) -> str:
    """
    Return what the figures of a page were made by, at which commit, on which machine.

    names are files in results/, or entries of results/stated.json as `stated:ENTRY`.
    """
    notes, taken_over = _read(root, 'sources'), _read(root, 'stated')
    lines = []
    for name in names:
        file, _, entry = name.partition(':')
        note = taken_over[entry] if entry else notes[file]
        made = [note] if entry else [*rows_of(root, file), _header(_read(root, file)), note]
        known = (', '.join(_distinct(made, 'commit')), '; '.join(_distinct(made, 'host')),
                 note.get('note'))
        lines.append(f'- [{entry or file}](../../results/{file}.json): `{note["command"]}`; '
                     f'commit {"; ".join(filter(None, known))}')
    return '\n'.join(lines)


def rows(root: Path, name: str) -> str:
    """Return the table of a file, by its name in TABLES."""
    plan = TABLES[name]
    words = _read(root, 'sources')[plan.file].get('labels', {})
    cells = [[words.get(cell, cell) for cell in (column.cell(row) for column in plan.columns)]
             for row in rows_of(root, plan.file) if plan.keep(row)]
    # A column in which nothing stands is left out.
    kept = [i for i in range(len(plan.columns)) if any(line[i] for line in cells)]
    return table([plan.columns[i].head for i in kept], [[line[i] for i in kept] for line in cells])


def suite(root: Path, file: str, measure: str) -> str:
    """Return one measure of a suite: a row for each method, a column for each scene."""
    form, factor = MEASURES[measure]
    found = {(row['method'], row['scene']): row.get(measure) for row in rows_of(root, file)}
    scenes = list(dict.fromkeys(scene for _, scene in found))
    return table(['method', *scenes], [
        [f'`{method}`', *(_figure(found.get((method, scene)), form, factor) for scene in scenes)]
        for method in dict.fromkeys(method for method, _ in found)])


def stated(root: Path, name: str) -> str:
    """Return a table that was taken over from notes: see results/stated.json."""
    content = _read(root, 'stated')[name]
    return table(content['columns'], [list(map(str, row)) for row in content['rows']])


def paper(root: Path) -> str:
    """Return the paper's own figures: PSNR / SSIM / LPIPS VGG of the whole image."""
    scenes = [scene for protocol in PAPER_SCENES.values() for scene in protocol]
    return table(['method', *scenes], [
        [name, *('{:.2f} / {:.3f} / {:.3f}'.format(*figures[scene]) for scene in scenes)]
        for name, figures in PAPER.items()])


def quality_over_time(root: Path) -> bytes:
    """Return the plot of `neo_fast` over minutes of training, SVG."""
    from neo_ros.reports.plot import Plot, plot_svg, Series
    found = rows_of(root, 'quality_over_time')
    minutes = [row['minutes'] for row in found]
    return plot_svg(Plot('', 'minutes of training', 'ring PSNR, dB', [
        Series('held-out photos', minutes, [row['validation_psnr'] for row in found]),
        Series('test frames', minutes, [row['ring_psnr'] for row in found])]))


def over_the_minutes(root: Path) -> bytes:
    """Return the plot of what `neo train --minutes` gives on two scenes over the minutes, SVG."""
    from neo_ros.reports.plot import Plot, plot_svg, Series
    found = sorted(rows_of(root, 'minutes'), key=lambda row: row['minutes'])
    return plot_svg(Plot('', 'minutes of training', 'ring PSNR, dB', [
        Series(scene + more, *zip(*((row['minutes'], row[key]) for row in found
                                    if (row['scene'], row['camera']) == (scene, camera))))
        for scene, camera in (('demo_flat', '256x256'), ('redkitchen', '160x240'))
        for more, key in (('', 'ring_psnr'), (', network', 'network_ring_psnr'))]))


def over_the_floor(root: Path, unit: str, values: Mapping[str, str]) -> bytes:
    """Return the plot of values, name and key each, of trained floors over their area, SVG."""
    from neo_ros.reports.plot import Plot, plot_svg, Series
    found = sorted((row for row in rows_of(root, 'building') if row['layout'] == TRAINED),
                   key=lambda row: row['area_m2'])
    return plot_svg(Plot('', 'floor, m2', unit, [
        Series(f'{name}, {camera}', *zip(*((row['area_m2'], row[key]) for row in found
                                           if row['camera'] == camera)))
        for name, key in values.items() for camera in ('128x128', '64x64')]))


def over_the_visits(root: Path, key: str) -> bytes:
    """Return the plot of a value of the flat that changes over the visits, SVG."""
    from neo_ros.reports.plot import Plot, plot_svg, Series
    found = rows_of(root, 'lives')
    return plot_svg(Plot('', 'visit', 'dB', [
        Series(name, *zip(*((row['visit'], math.nan if row[key] is None else row[key])
                            for row in found if (row['scene'], row['mode']) == (scene, mode))))
        for name, scene, mode in (
            ('as it was trained', 'demo_flat', 'none'), ('learnt', 'demo_flat', 'learn'),
            ('updated (second training)', 'demo_flat, second training', 'update'))]))


MAKERS: dict[str, Maker] = {
    'sources': sources, 'rows': rows, 'suite': suite, 'stated': stated, 'paper': paper}
PLOTS: dict[str, Callable[[Path], bytes]] = {
    'quality_over_time.svg': quality_over_time,
    'minutes.svg': over_the_minutes,
    'floor_quality.svg': lambda root: over_the_floor(root, 'dB', {
        'guided ring': 'guided_ring_psnr', 'field at the true pose': 'oracle_ring_psnr'}),
    'floor_time.svg': lambda root: over_the_floor(root, 'ms of the processor', {
        'a search': 'found_ms_median', 'following, p95': 'follow_ms_p95'}),
    'floor_size.svg': lambda root: over_the_floor(root, 'MB', {
        'resident': 'resident_mb', 'memory file': 'file_mb'}),
    'lives_changed.svg': lambda root: over_the_visits(root, 'changed_ring_psnr'),
    'lives_unchanged.svg': lambda root: over_the_visits(root, 'unchanged_ring_psnr')}


def _read(root: Path, name: str) -> Any:
    path = root / 'results' / f'{name}.json'
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise NeoError(f'{path}: expected a JSON file: {error}') from error


def _header(content: Any) -> Row:
    """Return commit and machine of a whole file, where it says them once."""
    if not isinstance(content, dict):
        return {}
    machine = content.get('host')
    if isinstance(machine, dict):
        return {'commit': machine['commit'], 'host': machine['cpu']}
    return {'commit': content.get('commit'), 'host': machine}


def _distinct(made: Iterable[Row], key: str) -> list[str]:
    return list(dict.fromkeys(row[key] for row in made if isinstance(row.get(key), str)))


def _figure(value: float | None, form: str, factor: float) -> str:
    return '' if value is None else form.format(value * factor)
