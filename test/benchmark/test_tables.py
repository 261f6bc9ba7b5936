"""What the tables of a benchmark say of scores that are known."""
from neo_ros.benchmark.tables import best_practical, markdown, pose_remark
from neo_ros.evaluation.evaluate import MethodScores, ROW_KEYS
from neo_ros.evaluation.metrics import summarise
import pytest


def scores(method, ring_psnr, ring_lpips_vgg=(0.5,) * 4, minutes=0.0, **further):
    """Return what a method scored on two walks of two frames, from a list per measure."""
    measures = {'ring_psnr': ring_psnr, 'ring_lpips_vgg': ring_lpips_vgg, **further}
    frames = [{'path_id': index // 2, **dict(zip(measures, map(float, values)))}
              for index, values in enumerate(zip(*measures.values()))]
    estimates = summarise(frames)
    row = {**dict.fromkeys(ROW_KEYS), 'protocol': 'square', 'method': method, 'commit': 'abc',
           **{name: estimates[name].mean for name in ('ring_psnr', 'ring_lpips_vgg')}}
    return MethodScores(method, True, frames, estimates, row, {'minutes': minutes})


RESULTS = [
    scores('mean_image', [15] * 4, [0.1] * 4),
    scores('warping', [21] * 4, [0.4] * 4, 2.0, uncovered=[0.1, 0.2, 0.3, 0.4]),
    scores('relocalized', [29, 29, 17, 17], [0.3, 0.3, 0.2, 0.2], 3.0),
    scores('guided', [30, 30, 20, 20], [0.3, 0.3, 0.4, 0.4], 4.0),
    scores('oracle', [40] * 4, [0.0] * 4)]


def test_the_first_is_a_method_that_a_robot_could_run():
    assert best_practical(RESULTS) == 'guided'
    assert best_practical(RESULTS, 'ring_lpips_vgg') == 'relocalized'
    assert best_practical([RESULTS[0], RESULTS[-1]]) is None
    assert best_practical(RESULTS, 'warping_error') is None


def test_each_table_has_its_own_best_in_bold():
    seam = [scores('warping', [21] * 4, seam_psnr=[30] * 4),
            scores('guided', [25] * 4, seam_psnr=[28] * 4),
            scores('oracle', [40] * 4, seam_psnr=[40] * 4)]
    bold = [line.split('|')[1].strip() for line in markdown([seam]).splitlines()
            if line.startswith('| **')]
    assert bold == ['**guided**', '**warping**']


def test_the_first_is_compared_with_the_second_frame_by_frame():
    table = markdown([RESULTS])
    # The walks differ by 10 dB, the methods by 1 to 3: an unpaired interval would hold 0.
    assert ('guided minus relocalized, frame by frame: 2.00 (1.00 to 3.00), on its worst walk '
            '1.00.') in table
    assert ('relocalized minus guided, frame by frame: -0.100 (-0.200 to 0.000), on its worst '
            'walk 0.000.') in table


def test_what_the_memory_is_worth_is_told_with_its_worst_walk():
    alone = scores('neo_fast', [20, 20, 21, 21])
    table = markdown([[alone, *RESULTS]])
    assert ('What the memory is worth, by ring PSNR; guided minus neo_fast, frame by frame: 4.50 '
            '(-1.00 to 10.00), on its worst walk -1.00.') in table


def test_the_gap_is_closed_by_lpips_too():
    table = markdown([[scores('naive', [10] * 4, [0.5] * 4), *RESULTS]])
    assert '| guided |  | 30 % |' in table and '| oracle |  | 100 % |' in table
    assert '| guided |  |  |' in markdown([RESULTS])


def test_the_mean_counts_each_scene_alike_and_methods_that_all_have():
    easy = [scores('guided', [34] * 4, [0.2] * 4), scores('naive', [20] * 4)]
    table = markdown([RESULTS, easy]).split('### Mean over 2 scenes')[1].split('###')[0]
    rows = [line for line in table.splitlines() if line.startswith('|')]
    assert rows[2:] == ['| guided | 29.50 (25.00 to 34.00) |  | 0.275 (0.200 to 0.350) |  |']
    assert 'Mean over' not in markdown([RESULTS])


def test_what_no_photo_covered_and_the_minutes_are_told():
    table = markdown([RESULTS])
    assert 'warping: no photo covered 25% of the ring' in table
    assert 'Trained and scored in 9 minutes, without attempts that were broken off;' in table


@pytest.mark.parametrize('count, middle, high', [(1, 0, 0), (3, 1, 2), (100, 50, 95)])
def test_pose_errors_are_told_by_median_and_95_percent(count, middle, high):
    # From the worst to the best: they are sorted first.
    errors = list(range(count))[::-1]
    frames = [{'pose_error_cm': error, 'pose_error_deg': error / 10,
               'pose_failed': float(error > 96)} for error in errors]
    said = pose_remark(MethodScores('relocalized', True, frames, {}, {}))
    assert said == (
        f'relocalized: pose error {middle}.0 cm, {middle / 10:.2f} deg in the median; '
        f'{high}.0 cm, {high / 10:.2f} deg at 95 %; {3 if count == 100 else 0} of {count} frames '
        'not localised.')


def test_the_papers_own_gap_is_told():
    table = markdown([RESULTS])
    assert 'NEO closed 43 % (Replica), 39 % (Gibson), 40 % (HM3D) of the gap in PSNR' in table
    assert 'Whether the observed centre was pasted in is not known.' in table
