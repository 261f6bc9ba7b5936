from collections.abc import Iterator
from dataclasses import asdict, fields, is_dataclass, replace
import hashlib
import json
import math
from pathlib import Path
from typing import Any

from neo_ros.errors import ConfigError, GeometryError
from neo_ros.experiment import Experiment, read_experiment, ViewConfig
from neo_ros.field.config import FieldConfig, FIT_NEAR
from neo_ros.geometry import Intrinsics, ViewExpansion
import neo_ros.machine.files
from neo_ros.outpaint.fitting import OutpaintConfig
from neo_ros.scenes.pose_sampling import SamplingConfig
import pytest

SHIPPED = neo_ros.machine.files.share_dir() / 'config' / 'experiments'
# What each ablation is compared with, and the settings that may differ from it.
ABLATIONS = {
    **{f'interval_{metres}': ('base', {'sampling.interval'})
       for metres in ('0_10', '0_20', '0_50', '1_00')},
    **{f'steps_{steps}': ('base', {'outpaint.steps'}) for steps in ('0625', '1250', '5000')},
    'no_augmentation': ('base', {'outpaint.photometric', 'outpaint.occluders'}),
    'no_real_centres': ('base', {'outpaint.real_centre'}),
    'perceptual': ('base', {'outpaint.perceptual'}),
    'source_view': ('no_real_centres', {'outpaint.training_view'}),
    'redkitchen/all_views': ('redkitchen/sharp_views', {'sampling.sharp_only'}),
    'redkitchen/no_augmentation': (
        'redkitchen/sharp_views', {'outpaint.photometric', 'outpaint.occluders'}),
    'redkitchen/no_real_centres': ('redkitchen/sharp_views', {'outpaint.real_centre'})}
PHOTO = Intrinsics(64, 48, 40.0, 41.0, 31.0, 25.0)


def read(tmp_path: Path, text: str) -> Experiment:
    (tmp_path / 'e.yaml').write_text(text)
    return read_experiment(tmp_path / 'e.yaml')


def changed_experiments(settings: Any) -> Iterator[tuple[str, Any]]:
    """Yield the name of every setting, and `settings` with that one changed."""
    changes = {'sh_degree': 1, 'precision': 'fp32', 'device': 'cpu', 'training_view': 'source',
               'name': 'lama', 'area': 'photos', 'minutes': 5.0, 'camera_height': 1.5,
               'interval': 0.3, 'near': 0.3, 'exposure': True, 'tile': 4.0, 'sharp_only': True,
               'average': 0.9, 'view': ViewConfig((8, 8), (16, 16))}
    for entry in fields(settings):
        value = getattr(settings, entry.name)
        if is_dataclass(value):
            for name, changed in changed_experiments(value):
                yield f'{entry.name}.{name}', replace(settings, **{entry.name: changed})
        elif isinstance(value, bool):
            yield entry.name, replace(settings, **{entry.name: not value})
        else:
            other = changes[entry.name] if entry.name in changes else value + 1
            yield entry.name, replace(settings, **{entry.name: other})


def test_the_old_name_of_a_setting_is_read_and_hashes_are_those_of_before(
        tmp_path: Path) -> None:
    old = read(tmp_path, 'network: {width: 8, memory: 96}')
    assert old == read(tmp_path, 'network: {width: 8, hidden: 96}')
    assert old.network.hidden == 96
    # The hash is that of the old word: a run folder of before is continued, not refused.
    settings = asdict(old)
    settings['network']['memory'] = settings['network'].pop('hidden')
    for part, name in (('field', 'depth'), ('field', 'shrink'), ('field', 'vignetting'),
                       ('field', 'sharpness'), ('field', 'robust'), ('field', 'tile'),
                       ('network', 'shrink'), ('memory', 'minutes')):
        del settings[part][name]
    # Left open it counts as what was the default then.
    assert settings['field']['exposure'] is None
    settings['field']['exposure'] = False
    text = json.dumps(settings, sort_keys=True)
    assert old.config_hash == hashlib.sha256(text.encode()).hexdigest()[:12]
    # Forbidden it is another field.
    never = replace(old, field=replace(old.field, exposure=False))
    assert never.config_hash != old.config_hash
    assert never.field_hash(mapped=False) != old.field_hash(mapped=False)
    with pytest.raises(ConfigError, match='network.memory is the old name of network.hidden.*'
                       'got both; leave network.memory out'):
        read(tmp_path, 'network: {memory: 96, hidden: 96}')
    with pytest.raises(ConfigError, match='network.hidden: .*integer.*many'):
        read(tmp_path, 'network: {memory: many}')


def test_an_empty_file_is_the_default(tmp_path: Path) -> None:
    assert read(tmp_path, '') == Experiment()
    assert read(tmp_path, '').config_hash == Experiment().config_hash


def test_the_least_width_of_a_network_is_that_of_its_kind(tmp_path: Path) -> None:
    for text in ('{width: 4, depth: 1}', '{width: 1, depth: 3}', '{name: lama, width: 1}'):
        assert read(tmp_path, f'network: {text}').network.width < 5


def test_anchors_are_read(tmp_path: Path) -> None:
    found = read(tmp_path, 'field: &own {minutes: 3}\noutpaint: {<<: *own, minutes: 5}\n')
    assert (found.field.minutes, found.outpaint.minutes) == (3, 5)


def test_settings_are_read_at_every_level(tmp_path: Path) -> None:
    found = read(tmp_path, 'seed: 7\nscale: 1\nview: {source: [160, 240], target: [320, 240]}\n'
                 'field: {steps: 20, exposure: true}\nnetwork: {patch: 8}\n')
    assert (found.seed, found.scale, found.field.steps, found.field.exposure) == (7, 1, 20, True)
    assert found.view == ViewConfig((160, 240), (320, 240)) and found.network.patch == 8
    assert found.outpaint == Experiment().outpaint


def test_the_hash_changes_with_every_setting() -> None:
    # Source views go without real centres, and shares end at 1.
    base = Experiment(outpaint=OutpaintConfig(real_centre=0.0, occluders=0.0))
    changed = dict(changed_experiments(base))
    assert {'seed', 'view', 'field.exposure', 'outpaint.precision', 'sampling.radius'} <= set(
        changed)
    hashes = [base.config_hash, *(e.config_hash for e in changed.values())]
    assert len(set(hashes)) == len(hashes) > 30
    assert all(len(text) == 12 and int(text, 16) >= 0 for text in hashes)


def test_the_hash_does_not_ask_how_a_file_is_written(tmp_path: Path) -> None:
    long = read(tmp_path, 'seed: 0\nfield:\n  voxels: 3_000_000\n  steps: 6000\nscale: 1\n')
    assert long.config_hash == Experiment().config_hash


@pytest.mark.parametrize('text, message', [
    ('sede: 1', r'e.yaml: sede: Unexpected keyword argument, got 1'),
    ('field: {step: 9}', 'field.step: Unexpected keyword argument'),
    ('sampling: {spacing: 1}', 'sampling.spacing: Unexpected'),
    ('network: {layers: 3}', 'network.layers: Unexpected'),
    ('outpaint: {lr: 1}', 'outpaint.lr: Unexpected'),
    ('view: {source: [8, 8], target: [16, 16], fov: 90}', 'view.fov: Unexpected'),
    ('seed: few', "seed: .*integer.*, got 'few'"),
    ('field: {steps: 10.5}', 'field.steps: .*integer.*, got 10.5'),
    ('field: {exposure: maybe}', 'field.exposure: .*boolean'),
    ('outpaint: [1, 2]', 'outpaint: .*got .1, 2.'),
    ('view: {source: [8], target: [16, 16]}', 'view.source'),
    ('view: {source: [8, 8]}', 'view.target: .*required'),
    ('field: {sh_degree: 5}', 'field.sh_degree: expected 0, 1 or 2, got 5$'),
    ('sampling: {area: garden}', "sampling.area: .*'auto', .*'photos', got 'garden'$"),
    ('sampling: {interval: 0}', 'e.yaml: sampling: expected finite interval, radius and positions '
     '> 0, got 0.0, 0.3, 1000$'),
    ('outpaint: {precision: fp8}', 'outpaint.precision: expected bf16 or fp32'),
    ('scale: 0', 'e.yaml: scale: expected a number > 0, got 0.0$'),
    ('scale: .nan', 'scale: expected a number > 0, got nan'),
    ('seed: -1', 'seed: expected 0 or more, below 2.63, got -1'),
    (f'seed: {2 ** 63}', 'seed: expected 0 or more'),
    ('- 1', r'e.yaml: .*got \[1\]'),
    ('[]', r'e.yaml: .*got \[\]'),
    ('0', 'e.yaml: .*got 0'),
    ('false', 'e.yaml: .*got False'),
    ('seed: 1\nfield:\n  steps: 9\nseed: 2', 'e.yaml: seed: expected once, .* line 4; write all'),
    ('field: {steps: 20, steps: 30}', 'e.yaml: steps: expected once, got it again in line 1'),
    ('network: {width: 1}', 'network.width: expected 2 or more at depth 2, got 1$'),
    ('network: {width: 3, depth: 1}', 'network.width: expected 4 or more at depth 1, got 3$'),
    ('outpaint: {photometric: .inf}', 'outpaint.photometric: expected 0 ... 1_000_000, got inf'),
    ('outpaint: {weight_decay: .inf}', 'outpaint.weight_decay: expected 0 ... 1_000_000, got inf'),
    ('seed: [', 'e.yaml: expected a YAML file'),
], ids=lambda value: str(value)[:30])
def test_wrong_settings_are_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read(tmp_path, text)


def test_files_that_are_no_text_are_refused(tmp_path: Path) -> None:
    (tmp_path / 'e.yaml').write_bytes(b'\xff\xfe\x00')
    for path in (tmp_path / 'e.yaml', tmp_path / 'none.yaml', tmp_path):
        with pytest.raises(ConfigError, match='expected a YAML file'):
            read_experiment(path)


@pytest.mark.parametrize(
    'path', sorted(SHIPPED.rglob('*.yaml')), ids=lambda path: path.stem)
def test_the_experiments_that_come_with_the_package_are_valid(path: Path) -> None:
    assert read_experiment(path) != Experiment()


@pytest.mark.parametrize('name', ABLATIONS)
def test_an_ablation_differs_from_its_reference_in_what_it_is_about(name: str) -> None:
    reference, keys = ABLATIONS[name]
    found, expected = (asdict(read_experiment(SHIPPED / 'ablations' / f'{file}.yaml'))
                       for file in (name, reference))
    assert {f'{part}.{key}' for part in ('field', 'sampling', 'network', 'outpaint', 'memory')
            for key in found[part] if found[part][key] != expected[part][key]} == keys
    assert all(found[key] == expected[key] for key in ('seed', 'scale', 'view'))


def test_no_ablation_is_forgotten() -> None:
    folder = SHIPPED / 'ablations'
    files = {str(path.relative_to(folder).with_suffix('')) for path in folder.rglob('*.yaml')}
    assert files == {*ABLATIONS, *(reference for reference, _ in ABLATIONS.values())}


def test_without_a_word_the_view_doubles() -> None:
    expansion = Experiment().expansion(PHOTO, None)
    assert expansion.source == PHOTO
    assert (expansion.target.width, expansion.target.height) == (128, 96)


def test_test_frames_say_what_is_wide() -> None:
    stated = ViewExpansion(PHOTO, 4, 8, 0, 2)
    assert Experiment().expansion(PHOTO, stated) == stated
    assert Experiment(scale=0.5).expansion(PHOTO, stated).target.width == 38
    view = ViewConfig((32, 48), (64, 48))
    assert Experiment(view=view).expansion(PHOTO, stated).left == 16


def test_horizontal_case_of_the_paper() -> None:
    # ScanNet: photos of 320x240, of which the camera of the robot sees the middle 160x240.
    photo = Intrinsics(320, 240, 290.0, 290.0, 161.0, 118.0)
    view = ViewConfig((160, 240), (320, 240))
    expansion = Experiment(view=view).expansion(photo, None)
    assert (expansion.source.height, expansion.source.width) == (240, 160)
    assert (expansion.left, expansion.right, expansion.top, expansion.bottom) == (80, 80, 0, 0)
    assert expansion.target == photo
    assert Experiment(view=view, scale=0.5).expansion(photo, None) == expansion.scaled(0.5)


@pytest.mark.parametrize('experiment, message', [
    (Experiment(scale=0.3, view=ViewConfig((64, 48), (96, 96))), 'scale: 0.3 does not give'),
    (Experiment(view=ViewConfig((64, 48), (65, 48))), 'an even growth'),
    (Experiment(view=ViewConfig((64, 48), (32, 48))), 'view.target: expected at least 64x48'),
    (Experiment(view=ViewConfig((64, 48), (64, 48))), 'view.target: expected growth at one side'),
    (Experiment(view=ViewConfig((0, 48), (64, 48))),
     'view.source: width: expected a positive integer'),
], ids=['half pixels', 'odd growth', 'shrinking', 'as it is', 'nothing'])
def test_views_that_cannot_be(experiment: Experiment, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        experiment.expansion(PHOTO, None)


def test_infinite_scales_are_refused() -> None:
    with pytest.raises(ConfigError, match='scale: expected a number > 0'):
        Experiment(scale=math.inf)


@pytest.mark.parametrize('area, mapped, near', [
    ('auto', True, FIT_NEAR), ('auto', False, None), ('photos', True, None),
    ('free_space', False, FIT_NEAR)])
def test_on_a_floor_the_photos_do_not_say_what_is_empty(
        area: Any, mapped: bool, near: float | None) -> None:
    experiment = Experiment(sampling=SamplingConfig(area=area))
    assert experiment.field_config(mapped) == FieldConfig(near=near)
    told = replace(experiment, field=FieldConfig(near=0.3))
    assert told.field_config(mapped) == FieldConfig(near=0.3)
    # What is the same field may be shared.
    shared = experiment.field_hash(mapped) == Experiment().field_hash(False)
    assert shared == (near is None)


def test_runs_of_before_measured_depth_keep_their_hash() -> None:
    assert Experiment().config_hash == 'a83d8bc2240c'
    weighed = Experiment(field=FieldConfig(depth=0.5))
    assert weighed.config_hash != Experiment().config_hash
    assert weighed.field_hash(False) != Experiment().field_hash(False)
