"""The scores of a replayed bag: a row per frame, as a table and as a report."""
from collections.abc import Callable
import csv
import io
import json
from pathlib import Path
from typing import Any

from neo_ros.errors import ImageRejected
from neo_ros.evaluation.baselines import EdgeReplication
from neo_ros.evaluation.metrics import psnr, score_frame
from neo_ros.evaluation.narrower_camera import NarrowerCamera
from neo_ros.geometry import ViewExpansion
from neo_ros.machine.files import write_bytes
from neo_ros.reports.report import Plot, Section, Series, Table, Text, write_report
from neo_ros.reports.strips import frame_strip
import numpy as np

CSV_FILE, JSON_FILE, REPORT_FILE = 'scores.csv', 'scores.json', 'report.html'
# Frames whose pictures are kept for the report, spread over the bag, beside best and worst.
MAX_SAMPLES = 8
_LABELS = {'ring_psnr': 'ring PSNR, dB', 'ring_ssim': 'ring SSIM', 'seam_psnr': 'seam PSNR, dB',
           'seam_ssim': 'seam SSIM', 'whole_psnr': 'whole PSNR, dB', 'whole_ssim': 'whole SSIM',
           'edge_ring_psnr': 'ring PSNR of edge replication, dB'}
Images = tuple[np.ndarray, np.ndarray]  # truth and prediction
Expand = Callable[[np.ndarray], np.ndarray]


class BagScores:
    """
    Scores frame by frame; give it to `replay` as `on_pair` or, with `expand`, as `on_frame`.

    expansion  that of the model
    expand     widens one image with the model; given, the camera is scored against itself, see
               NarrowerCamera; not the function that the replay runs, if it remembers frames
    `rows` holds per frame stamp_ns, seconds since the first one, the scores of `score_frame`,
    and ring PSNR of edge replication as the floor.
    """

    def __init__(self, expansion: ViewExpansion, expand: Expand | None = None) -> None:
        self.camera = None if expand is None else NarrowerCamera(expansion)
        self.expansion = expansion if self.camera is None else self.camera.expansion
        self._expand = expand
        self._edges = EdgeReplication(self.expansion)
        self._ring = self.expansion.extrapolated_mask
        self.rows: list[dict[str, Any]] = []
        self._samples: dict[int, Images] = {}
        self._extremes: dict[str, tuple[int, Images]] = {}
        self._step = 1

    def add_pair(self, stamp_ns: int, truth: np.ndarray, wide_image: np.ndarray) -> None:
        """Score a wide image (H, W, 3) against the truth of the same stamp."""
        edges = self._edges.expand(np.ascontiguousarray(self.expansion.crop(truth)))
        first_ns = self.rows[0]['stamp_ns'] if self.rows else stamp_ns
        row = {'stamp_ns': stamp_ns, 'seconds': (stamp_ns - first_ns) / 1e9,
               **score_frame(truth, wide_image, self.expansion),
               'edge_ring_psnr': psnr(truth[self._ring], edges[self._ring])}
        self.rows.append(row)
        self._keep(len(self.rows) - 1, (truth, wide_image))

    def add_frame(self, stamp_ns: int, image: np.ndarray, wide_image: np.ndarray) -> None:
        """Score the model on a recorded image (h, w, 3) against this image itself."""
        if self.camera is None or self._expand is None:
            raise ImageRejected('truth', 'expected `expand`, without it there is nothing to score')
        widened = self._expand(self.camera.model_input(image))
        self.add_pair(stamp_ns, np.ascontiguousarray(self.camera.truth(image)),
                      self.camera.prediction(widened, image))

    @property
    def mean(self) -> dict[str, float]:
        """The mean of every score over the frames."""
        return {name: float(np.mean([row[name] for row in self.rows])) for name in _LABELS}

    @property
    def lowest(self) -> dict[str, float]:
        """The lowest of every score over the frames."""
        return {name: min(row[name] for row in self.rows) for name in _LABELS}

    def write(self, folder: Path, about: dict[str, Any]) -> None:
        """
        Write scores.csv, scores.json and report.html into the folder.

        about  what was scored: goes to the top of scores.json and of the report
        Raises NeoError when a file cannot be written.
        """
        about = {**about, 'how': self.how(about)}
        if self.camera is not None:
            about['focal_length_ratio'] = self.camera.focal_ratio
        text = io.StringIO()
        table = csv.DictWriter(text, list(self.rows[0]), lineterminator='\n')
        table.writeheader()
        table.writerows(self.rows)
        write_bytes(folder / CSV_FILE, text.getvalue().encode())
        write_bytes(folder / JSON_FILE, (json.dumps(
            {**about, 'mean': self.mean, 'frames': self.rows}, indent=1) + '\n').encode())
        write_report(folder / REPORT_FILE, f'How well {about["bag"]} is widened',
                     self._sections(about))

    def how(self, about: dict[str, Any]) -> str:
        """Say what the frames were held against."""
        if self.camera is not None:
            return self.camera.describe()
        return f'Scored against the wide images of {about["truth_topic"]}, joined by their stamps.'

    def _keep(self, index: int, images: Images) -> None:
        """Keep the pictures of the best and the worst frame, and of some in between."""
        score = self.rows[index]['ring_psnr']
        for name, better in (('Best', 1), ('Worst', -1)):
            kept = self._extremes.get(name)
            if kept is None or better * (score - self.rows[kept[0]]['ring_psnr']) > 0:
                self._extremes[name] = index, images
        if index % self._step == 0:
            self._samples[index] = images
        if len(self._samples) > MAX_SAMPLES:
            self._step *= 2
            self._samples = {key: value for key, value in self._samples.items()
                             if key % self._step == 0}

    def _sections(self, about: dict[str, Any]) -> list[Section]:
        mean, lowest = self.mean, self.lowest
        facts = ', '.join(f'{key.replace("_", " ")} {value}' for key, value in about.items()
                          if value is not None and key not in ('how', 'bag'))
        sections: list[Section] = [
            Text(f'{about["how"]}\n{facts}.'),
            Table(('score', f'mean of {len(self.rows)} frames', 'lowest'),
                  [(label, f'{mean[name]:.3f}', f'{lowest[name]:.3f}')
                   for name, label in _LABELS.items()], 'Scores',
                  'The ring is what the model made up. Edge replication repeats the outermost '
                  f'pixels of the camera: the floor. Every frame stands in {CSV_FILE}.'),
            Plot('Ring PSNR along the bag', 'seconds', 'ring PSNR, dB', [
                Series(label, [row['seconds'] for row in self.rows],
                       [row[name] for row in self.rows])
                for name, label in (('ring_psnr', 'model'),
                                    ('edge_ring_psnr', 'edge replication'))])]
        shown = [(name, *kept) for name, kept in self._extremes.items()]
        shown += [('Along the bag', index, images) for index, images in self._samples.items()]
        for title, index, (truth, prediction) in shown:
            row = self.rows[index]
            sections.append(frame_strip(
                f'{title}: second {row["seconds"]:.2f}', self.expansion,
                self.expansion.crop(truth), prediction, truth,
                f'ring {row["ring_psnr"]:.2f} dB, SSIM {row["ring_ssim"]:.3f}'))
        return sections
