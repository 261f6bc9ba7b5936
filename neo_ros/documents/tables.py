"""The columns of the tables of docs/results/, and which file's rows stand in them."""
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Column:
    """A column: its head, the key of a row (dots lead inwards), its format, a factor before."""

    head: str
    key: str
    form: str = '{}'
    factor: float = 1

    def cell(self, row: Row) -> str:
        """Return the text of a row; empty where the row has no value."""
        value: Any = row
        for part in self.key.split('.'):
            value = None if value is None else value.get(part)
        if value is None:
            return ''
        return self.form.format(value if isinstance(value, str) else value * self.factor)


@dataclass(frozen=True)
class Rows:
    """A table of the rows of a file, those that `keep` holds for."""

    file: str
    columns: tuple[Column, ...]
    keep: Callable[[Row], bool] = lambda row: True


DB, RATIO, MS = '{:.2f}', '{:.3f}', '{:.1f}'
METHOD = (
    Column('method', 'method', '`{}`'), Column('ring PSNR, dB', 'ring_psnr', DB),
    Column('ring SSIM', 'ring_ssim', RATIO), Column('ring LPIPS VGG', 'ring_lpips_vgg', RATIO),
    Column('whole PSNR, dB', 'whole_psnr', DB), Column('minutes', 'train_minutes', '{:.1f}'))
COMPARED = (
    Column('network', 'name'), Column('views seen', 'samples', '{:,}'),
    Column('GFLOP', 'gflop', DB), Column('ms', 'milliseconds', MS),
    Column('MB', 'megabytes', '{:.1f}'), Column('held-out photos, dB', 'validation_psnr', DB),
    Column('test frames, dB', 'ring_psnr', DB))
ABLATION = (
    Column('setting', 'name'), Column('views seen', 'samples', '{:,}'),
    Column('held-out photos, dB', 'validation_psnr', DB),
    Column('test frames, dB', 'ring_psnr', DB))
FIELD = (
    Column('scene', 'scene'), Column('field', 'implementation'), Column('voxels', 'config_hash'),
    Column('minutes', 'minutes', '{:.0f}'), Column('steps', 'steps', '{:,}'),
    Column('held-out photos, dB', 'held_out_psnr', DB),
    Column('wide views, dB', 'whole_psnr', DB), Column('SSIM', 'whole_ssim', RATIO),
    Column('LPIPS VGG', 'whole_lpips_vgg', RATIO))
NODE = (
    Column('', 'name'), Column('images out, Hz', 'rate_hz', MS),
    Column('median, ms', 'median_ms', MS), Column('p95, ms', 'p95_ms', MS),
    Column('p99, ms', 'p99_ms', MS),
    Column('of it decode, check, publish, ms', 'details.decode_check_publish_ms', MS),
    Column('processor', 'details.cpu_percent', '{:.0f} %'),
    Column('resident, MB', 'details.rss_mb', '{:.0f}'))
TIMED = (
    Column('', 'name'), Column('median, ms', 'median_ms', MS), Column('p99, ms', 'p99_ms', MS),
    Column('over the floor', 'measured_over_floor', '{:.1f}'))
SOAK = (
    Column('seconds', 'seconds', '{:.0f}'), Column('busy processes beside it', 'hogs'),
    Column('images out, Hz', 'mean_rate_hz', MS),
    Column('median, ms', 'latency_ms.whole.median', MS),
    Column('p99, ms', 'latency_ms.whole.p99', MS), Column('most, ms', 'latency_ms.whole.max', MS),
    Column('memory first, MB', 'rss_mb.first', '{:.0f}'),
    Column('memory last, MB', 'rss_mb.last', '{:.0f}'),
    Column('diagnostics late', 'missed_beats'))
HARD = (
    Column('images', 'case'), Column('known by the memory', 'known', '{:.0f} %', 100),
    Column('guided ring, dB', 'ring_psnr', DB), Column('network alone, dB', 'network_psnr', DB),
    Column('ahead on the worst walk, dB', 'worst_walk', DB),
    Column('images until found', 'search'))
OUTSIDE = (
    Column('frames', 'frames'), Column('count', 'count'),
    Column('known by the memory', 'known', '{:.0f} %', 100), Column('score', 'score', DB),
    Column('AUROC', 'auroc', RATIO), Column('score, network alone', 'network_score', DB),
    Column('AUROC, network alone', 'network_auroc', RATIO))
GEOMETRY_POSE = (
    Column('scene', 'scene'), Column('camera', 'camera'), Column('frames', 'n_frames'),
    Column('found', 'pose_share', '{:.0f} %', 100),
    Column('position, cm', 'position_cm_median', DB), Column('p95', 'position_cm_p95', DB),
    Column('rotation, degrees', 'rotation_deg_median', RATIO),
    Column('p95', 'rotation_deg_p95', RATIO),
    Column('position within the stated 95 %', 'position_covered_95', '{:.1f} %', 100),
    Column('rotation within it', 'rotation_covered_95', '{:.1f} %', 100))
GEOMETRY_DEPTH = (
    Column('scene', 'scene'), Column('median error', 'depth_error_median', '{:.1f} %', 100),
    Column('within 5 %', 'depth_within_5_percent', '{:.0f} %', 100),
    Column('more than 10 % too far', 'depth_too_far_10_percent', '{:.1f} %', 100),
    Column('occupied cells marked', 'occupied_marked', '{:.1f} %', 100),
    Column('free cells marked', 'free_marked_occupied', '{:.1f} %', 100))
POINT_DEPTH = (
    Column('scene', 'scene'), Column('depth of', 'what'), Column('points', 'points', '{:,}'),
    Column('known', 'known', '{:.0f} %', 100),
    Column('median error', 'depth_error_median', '{:.1f} %', 100),
    Column('within 5 %', 'depth_within_5_percent', '{:.0f} %', 100),
    Column('more than 10 % too far', 'depth_too_far_10_percent', '{:.1f} %', 100))
MEASURED_DEPTH = (
    Column('steps', 'steps', '{:,}'), Column('depth', 'depth'),
    Column('minutes of the processor', 'cpu_minutes', '{:.1f}'),
    Column('photos held out, dB', 'field_held_out_psnr', DB),
    Column("field's ring, dB", 'field_ring_psnr', DB),
    Column("field's depth off by", 'field_depth_error_median', '{:.1f} %', 100),
    Column('guided ring, dB', 'guided_ring_psnr', DB),
    Column('its depth off by', 'guided_depth_error_median', '{:.1f} %', 100),
    Column('position off by, cm', 'position_cm_median', DB))
LOOKS = (
    Column('scene', 'scene'), Column('delay, s', 'delay_s', '{:g}'), Column('looks', 'looks'),
    Column('position as it came, cm', 'as_came_position_cm', '{:.0f}'),
    Column('predicted, cm', 'predicted_position_cm', '{:.0f}'),
    Column('look as it came, dB', 'as_came_psnr', DB),
    Column('predicted, dB', 'predicted_psnr', DB))
MINUTES = (
    Column('scene', 'scene'), Column('camera', 'camera'), Column('photos', 'photos'),
    Column('`--minutes`', 'minutes', '{:g}'), Column('took', 'elapsed_minutes', '{:.1f}'),
    Column('keyframes', 'keyframes'), Column('guided ring, dB', 'ring_psnr', DB),
    Column('SSIM', 'ring_ssim', RATIO), Column('network alone, dB', 'network_ring_psnr', DB),
    Column('oracle, dB', 'oracle_ring_psnr', DB), Column('memory, MB', 'memory_mb', '{:.1f}'),
    Column('model, MB', 'model_mb', '{:.1f}'), Column('resident, GB', 'resident_gb', '{:.1f}'))
IMPORTS = (
    Column('capture', 'capture'), Column('images', 'frames', '{:,}'),
    Column('photos in the scene', 'photos', '{:,}'),
    Column('peak memory, MB', 'peak_mb', '{:.0f}'),
    Column('minutes of the processor', 'cpu_minutes', '{:.1f}'),
    Column('minutes', 'minutes', '{:.1f}'))
REAL = (
    Column('scene', 'scene'), Column('field', 'name'), Column('steps', 'steps', '{:,}'),
    Column('walks, dB', 'whole_psnr', DB), Column('ring', 'ring_psnr', DB),
    Column('walks aligned, dB', 'aligned_whole_psnr', DB),
    Column('ring', 'aligned_ring_psnr', DB), Column('ring LPIPS', 'aligned_ring_lpips_vgg', RATIO),
    Column('photos held out, dB', 'held_out_psnr', DB),
    Column('aligned', 'aligned_held_out_psnr', DB),
    Column('minutes of the processor', 'cpu_minutes', '{:.1f}'))
LIVES = (
    Column('scene', 'scene'), Column('visit', 'visit'), Column('light', 'light'),
    Column('door', 'door'),
    Column('memory', 'mode'),
    Column('ring that changed, dB', 'changed_ring_psnr', DB),
    Column('ring that did not, dB', 'unchanged_ring_psnr', DB),
    Column('false changes', 'false_change_share', '{:.2f} %', 100),
    Column('mended', 'mended_share', '{:.2f} %', 100),
    Column('AUROC of contradicted', 'contradiction_auroc', RATIO),
    Column('poses right', 'pose_share', '{:.0f} %', 100),
    Column('memory and what was learnt, MB', 'memory_mb', '{:.2f}'),
    Column('minutes of the update', 'update_minutes', '{:.1f}'))
KILLS = (
    Column('killed', 'part'), Column('when', 'moment'), Column('kills', 'kills'),
    Column('loads afterwards', 'loaded'), Column('whole records lost', 'lost_records'),
    Column('last record cut off', 'cut_short'), Column('files damaged', 'damaged'),
    Column('tried whether it goes on', 'tried'), Column('it does', 'resumed'),
    Column('images not learnt yet, s', 'seconds_lost_max', '{:.1f}'))
BUILDING = (
    Column('rooms', 'layout'), Column('search', 'search'), Column('searches', 'searches'),
    Column('wrong place believed', 'wrong_places'), Column('ambiguous', 'ambiguous'),
    Column('not found', 'lost'), Column('right with a prior', 'prior_right'),
    Column('wrong with it', 'prior_wrong'), Column('walks through doors', 'door_walks'),
    Column('right at the end', 'walks_found_right'), Column('ever wrong', 'walks_ever_wrong'),
    Column('search, ms', 'found_ms_median', '{:.0f}'), Column('p95', 'found_ms_p95', '{:.0f}'))

# A camera that is taken to another floor.
LIFTS = (
    Column('rooms', 'layout'), Column('search', 'search'),
    Column('rides in a lift', 'lift_rides'), Column('right at the end', 'rides_found_right'),
    Column('ever wrong', 'rides_ever_wrong'))

# What searches on a floor cost, however its memory was made.
SEARCHED = (
    Column('searches', 'searches'), Column('wrong place believed', 'wrong_places'),
    Column('ambiguous', 'ambiguous'), Column('not found', 'lost'),
    Column('search, ms of the processor', 'found_ms_median', '{:.0f}'),
    Column('p95', 'found_ms_p95', '{:.0f}'), Column('following, p95', 'follow_ms_p95', '{:.0f}'),
    Column('memory file, MB', 'file_mb', '{:.1f}'),
    Column('resident, MB', 'resident_mb', '{:.0f}'))
# All rooms of these are different: what grows with the floor is told.
LARGE = ('a floor of ', 'two floors of ')
FLOORS = (
    Column('floors', 'floors'), Column('rooms of each', 'rooms'), Column('m2', 'area_m2'),
    Column('found by landmarks', 'by_landmarks'), *SEARCHED)
# Floors that were photographed and trained.
TRAINED = 'trained'
TRAINED_FLOORS = (
    Column('camera', 'camera'), Column('floors', 'floors'), Column('rooms of each', 'rooms'),
    Column('m2', 'area_m2'), Column('photos', 'photos', '{:,}'),
    Column('tiles', 'tiles'), Column('minutes', 'train_minutes', '{:.0f}'),
    Column('guided ring, dB', 'guided_ring_psnr', DB),
    Column('through the first door', 'first_walk_ring_psnr', DB),
    Column('one room, through that door', 'one_room_ring_psnr', DB),
    Column('field at the true pose', 'oracle_ring_psnr', DB),
    Column('frames guided', 'guided_share', '{:.1f} %', 100),
    Column('down a corridor', 'corridor_ring_psnr', DB),
    Column('near borders of tiles', 'border_ring_psnr', DB), *SEARCHED)

TABLES: dict[str, Rows] = {
    **{name: Rows(name, METHOD) for name in (
        'staircase_60', 'living_room_40', 'redkitchen_30', 'redkitchen_6')},
    **{name: Rows(name, COMPARED) for name in (
        'compare_networks', 'compare_small', 'compare_widths', 'quality_over_time')},
    **{name: Rows(name, ABLATION) for name in (
        'compare_ablations', 'compare_ablations_more', 'compare_ablations_redkitchen')},
    'field_curve': Rows('field_curve', FIELD),
    'node': Rows('node', NODE, lambda row: row['floor_ms'] is not None),
    'outputs': Rows('node', TIMED[:3], lambda row: row['floor_ms'] is None),
    'networks': Rows('networks', TIMED),
    'stream': Rows('stream', TIMED), 'soak': Rows('soak', SOAK), 'hogs': Rows('hogs', SOAK),
    'geometry_pose': Rows('geometry', GEOMETRY_POSE),
    'geometry_depth': Rows('geometry', GEOMETRY_DEPTH,
                           lambda row: row['depth_error_median'] is not None),
    'point_depth': Rows('point_depth', POINT_DEPTH),
    'measured_depth': Rows('measured_depth', MEASURED_DEPTH),
    'predicted_looks': Rows('predicted_looks', LOOKS),
    'imports': Rows('imports', IMPORTS),
    'building': Rows('building', BUILDING,
                     lambda row: not row['layout'].startswith((*LARGE, TRAINED))),
    'lifts': Rows('building', LIFTS, lambda row: row.get('lift_rides', 0) > 0),
    'floors': Rows('building', FLOORS, lambda row: 'by_landmarks' in row and (
        row['search'] != 'before') and row['layout'].startswith((*LARGE, 'all different'))),
    'trained_floors': Rows('building', TRAINED_FLOORS,
                           lambda row: row['layout'] == TRAINED),
    'real_ablations': Rows('real_ablations', REAL),
    'lives': Rows('lives', LIVES), 'kills': Rows('kills', KILLS),
    'minutes': Rows('minutes', MINUTES),
    'hard_times': Rows('hard_times', HARD), 'out_of_scene': Rows('out_of_scene', OUTSIDE),
}
# Over all scenes of a suite: the key of a row, its format and a factor.
MEASURES = {
    'ring_psnr': (DB, 1.0), 'ring_lpips_vgg': (RATIO, 1.0), 'ring_ssim': (RATIO, 1.0),
    'whole_psnr': (DB, 1.0), 'whole_ssim': (RATIO, 1.0), 'whole_lpips_vgg': (RATIO, 1.0),
    'oracle_gap_closed': ('{:.0f} %', 100.0), 'warping_error': ('{:.2f}', 1e3),
    'latency_ms_median': (MS, 1.0), 'train_minutes': ('{:.1f}', 1.0), 'model_mb': ('{:.1f}', 1.0)}
