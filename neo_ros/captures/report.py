"""Is my capture good enough? A page with the answer, and the same in a few lines of text."""
from collections.abc import Sequence
from pathlib import Path

import cv2
from neo_ros.captures.report_map import draw_map
from neo_ros.captures.report_measures import (
    ASSUMED_DISTANCE, CaptureMeasures, GOOD_OVERLAP, measure_capture)
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.pictures.sharpness import SHARPNESS_FLOOR
from neo_ros.reports.report import Picture, Plot, Section, Series, Strip, Table, Text, write_report
from neo_ros.scenes.scene import Scene
import numpy as np

REPORT_FILE = 'capture.html'
FEW_PHOTOS = 50
# Photos so near to the one before, metres and radians, show nothing new.
HARDLY_APART = 0.03, 0.05
# A side of the wide view that was seen less than this is worth recording more of.
WELL_SEEN = 0.8
PLACE = 1.0
HEADINGS = 8


def write_capture_report(folder: Path, scene: Scene, notes: Sequence[str] = (),
                         progress: Progress = no_progress) -> list[str]:
    """
    Write FOLDER/capture.html on the training photos of a scene.

    `notes` are what the import had to say. Returns the verdict as lines of plain text. Raises
    NeoError where the page cannot be written.
    """
    measures = measure_capture(scene, progress)
    facts, advice = describe(measures)
    m, metres = _units(measures)
    sections: list[Section] = [Text('\n'.join(advice) or 'Nothing stands out: go on to neo train.',
                                    'What to record more of')]
    if notes:
        sections.append(Text('\n'.join(notes), 'From the import'))
    sections += [
        Table(['Measure', 'Value'], facts, 'In figures',
              f'Overlap and wide view are estimates: everything is taken to be '
              f'{ASSUMED_DISTANCE:g} {m} away, and walls in between are not known.'),
        Picture('From above', draw_map(measures, scene.walkable),
                'Every dot is a photo, its tick the viewing direction; red: little of the wide '
                'view was seen from near there, green: all of it. Shaded: walkable floor. '
                f'Numbers are {metres}.'),
        Picture('The wide view, averaged over the photos', _draw_wide(measures),
                'The brighter, the more often some photo saw this direction; the frame is the '
                'photo itself.'),
        *_places(measures), *_plots(measures), *_strips(measures)]
    write_report(folder / REPORT_FILE, f'Is the capture of {scene.name} good enough?', sections)
    return [f'{name}: {value}' for name, value in facts] + advice


def describe(measures: CaptureMeasures) -> tuple[list[tuple[str, str]], list[str]]:
    """Return the figures as (name, value) rows, and advice in plain sentences."""
    photos = measures.photos
    beyond = measures.beyond_photo
    overlapping = float((measures.overlap >= GOOD_OVERLAP).mean())
    wide = float(measures.wide_seen.mean())
    extra = (f'outside the photo itself {measures.wide_seen[:, beyond].mean():.0%}'
             if beyond.any() else 'the photos are as wide as the wide view')
    blurred, drift = measures.blurred, measures.exposure_drift
    facts = [
        ('Photos', f'{len(photos)}'),
        ('Extent', ' x '.join(f'{size:.1f}' for size in np.ptp(
            photos.T_world_cam[:, :3, 3], axis=0)) + f' {_units(measures)[0]}'),
        ('Photos with a good neighbour', f'{overlapping:.0%} (another photo sees at least '
                                         f'{GOOD_OVERLAP:.0%} of the same)'),
        ('Wide view seen by some photo', f'{wide:.0%}, {extra}'),
        ('Blurred photos', f'{len(blurred)} of {len(measures.measured)} measured'),
        ('Exposure drift', f'{drift:.0%} of the mean brightness')]
    if measures.walkable_near is not None:
        facts.append(('Walkable floor within 1 m of a photo', f'{measures.walkable_near:.0%}'))
    advice = []
    if len(photos) < FEW_PHOTOS:
        advice.append(f'{len(photos)} photos are few: {FEW_PHOTOS} to 1000 make a good scene.')
    still = _hardly_apart(measures)
    if still > 0.5 * len(photos):
        advice.append(f'{still} photos are hardly apart from the one before, and take the time of '
                      'a training from the others: import again with --keyframe-distance 0.1 '
                      '--keyframe-angle 10.')
    if overlapping < 0.9:
        alone = int((measures.overlap < GOOD_OVERLAP).sum())
        advice.append(f'{alone} photos have no neighbour that sees the same: take photos closer '
                      'together, and turn more slowly.')
    if len(blurred) > 0.05 * len(measures.measured):
        advice.append(f'{len(blurred)} photos look blurred (see below): move more slowly, with '
                      'more light; of a video keep the sharp frames (--keyframe-distance 0.1).')
    if drift > 0.3:
        advice.append('The brightness drifts: lock exposure and white balance of the camera.')
    advice += _side_advice(measures)
    if measures.walkable_near is not None and measures.walkable_near < 0.9:
        advice.append(f'{1 - measures.walkable_near:.0%} of the walkable floor is more than 1 m '
                      'from any photo: walk there too (see the map).')
    return facts, advice


def _hardly_apart(measures: CaptureMeasures) -> int:
    """Count photos that show nothing that the one before does not."""
    poses = measures.photos.poses
    if measures.photos.arbitrary_scale:
        return 0
    return sum(not pose.is_apart(before, *HARDLY_APART)
               for before, pose in zip(poses, poses[1:]))


def _units(measures: CaptureMeasures) -> tuple[str, str]:
    return ('units', 'units') if measures.photos.arbitrary_scale else ('m', 'metres')


def _side_advice(measures: CaptureMeasures) -> list[str]:
    rows, columns = np.nonzero(measures.beyond_photo)
    height, width = measures.beyond_photo.shape
    seen = measures.wide_seen[:, rows, columns].mean(axis=0)
    # Each ray beyond the photo belongs to the side that it is farthest out on.
    across, down = (columns + 0.5) / width - 0.5, (rows + 0.5) / height - 0.5
    sides = np.where(np.abs(across) >= np.abs(down),
                     np.where(across < 0, 'on the left', 'on the right'),
                     np.where(down < 0, 'above', 'below'))
    words = {'on the left': 'turn the camera further to the left',
             'on the right': 'turn the camera further to the right',
             'above': 'tilt the camera up', 'below': 'tilt the camera down'}
    lines = []
    for side, what in words.items():
        share = float(seen[sides == side].mean()) if (sides == side).any() else 1.0
        if share < WELL_SEEN:
            lines.append(f'What the wide view adds {side} was seen to {share:.0%}: '
                         f'{what} too, at every place.')
    return lines


def _places(measures: CaptureMeasures) -> list[Section]:
    """Tabulate the squares where the wide view was seen least, and which way to look."""
    T = measures.photos.T_world_cam[measures.viewed]
    cells = np.floor(T[:, :2, 3] / PLACE).astype(int)
    headings = measures.wide_headings
    found = []
    for cell in np.unique(cells, axis=0):
        here = np.flatnonzero((cells == cell).all(axis=1))
        seen = measures.wide_seen[here]
        heading = headings[here][~seen]
        if seen.mean() >= WELL_SEEN or not heading.size:
            continue
        sectors = np.round(heading / (360 / HEADINGS)).astype(int) % HEADINGS
        counts = np.bincount(sectors, minlength=HEADINGS)
        worst = [sector for sector in counts.argsort()[::-1][:2] if counts[sector]]
        centre = (cell + 0.5) * PLACE
        found.append((float(seen.mean()), (
            f'x {centre[0]:.1f}, y {centre[1]:.1f}', f'{seen.mean():.0%}', f'{len(here)}',
            ' and '.join(f'{sector * 360 // HEADINGS} deg' for sector in worst),
            measures.photos.image_paths[measures.viewed[here[0]]].name)))
    if not found:
        return []
    found.sort(key=lambda entry: entry[0])
    m, metres = _units(measures)
    return [Table([f'Place, {metres}', 'Wide view seen', 'Photos', 'Look towards', 'For example'],
                  [row for _, row in found[:8]], 'Places to go back to',
                  f'Squares of {PLACE:g} x {PLACE:g} {m}. '
                  'Headings: 0 deg is along +x, 90 deg along +y.')]


def _plots(measures: CaptureMeasures) -> list[Section]:
    logarithms = np.log10(np.maximum(measures.sharpness, SHARPNESS_FLOOR))
    counts, edges = np.histogram(logarithms, bins=min(30, max(5, len(logarithms) // 10)))
    threshold = float(np.log10(max(measures.blur_threshold, SHARPNESS_FLOOR)))
    shares, share_edges = np.histogram(measures.overlap, bins=20, range=(0, 1))
    order = measures.measured.tolist()
    return [
        Plot('Sharpness', 'log10 of Laplacian variance over contrast', 'photos',
             [Series('photos', ((edges[1:] + edges[:-1]) / 2).tolist(), counts.tolist()),
              Series('blurred below', [threshold, threshold], [0, int(counts.max())])],
             note='The limit is three robust deviations below the median of these photos.'),
        Plot('Brightness over time', 'photo', 'mean, 0 black to 1 white',
             [Series('mean brightness', order, measures.brightness.tolist())]),
        Plot('Overlap', 'share that the best other photo sees too', 'photos',
             [Series('photos', ((share_edges[1:] + share_edges[:-1]) / 2).tolist(),
                     shares.tolist())])]


def _strips(measures: CaptureMeasures) -> list[Section]:
    order = np.argsort(measures.sharpness)[:4]
    return [Strip('The least sharp photos', [
        (f'{measures.photos.image_paths[index].name}: {value:.2f}',
         measures.photos.read_image(int(index)))
        for index, value in zip(measures.measured[order], measures.sharpness[order])])]


def _draw_wide(measures: CaptureMeasures) -> np.ndarray:
    target, observed = measures.expansion.target, measures.expansion.observed
    scale = 480 / target.width
    share = measures.wide_seen.mean(axis=0)
    grey = cv2.resize((share * 255).astype(np.uint8), (480, round(target.height * scale)),
                      interpolation=cv2.INTER_NEAREST)
    image = cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS)[..., ::-1].copy()
    rows, columns = observed
    start = (round(columns.start * scale), round(rows.start * scale))
    stop = (round(columns.stop * scale), round(rows.stop * scale))
    cv2.rectangle(image, start, stop, (255, 255, 255), 2)
    return image
