"""What an output folder is a run of: none is mixed with another, but a field may be shared."""
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
import json
from pathlib import Path
import shutil
from typing import Any

from neo_ros.errors import ConfigError, NeoError
from neo_ros.experiment import Experiment
from neo_ros.field.given_geometry import GivenGeometry
from neo_ros.machine.files import share_file, write_bytes
from neo_ros.scenes.digests import files_digest, floors_digest, list_digest
from neo_ros.scenes.scene import Scene
from neo_ros.training.memory import NOTES, WORK
from neo_ros.training.tiles import TILES
from neo_ros.training.time_plan import PLAN_FILE, read_plan

RUN_FILE = 'run.json'


def claim(out: Path, scene: Scene, experiment: Experiment,
          geometry: GivenGeometry | None = None, folder: Path | None = None) -> None:
    """
    Refuse a folder that holds another run, so that no two are ever mixed.

    folder: where the scene lies, noted for `scene_folder`.
    """
    note, path = _run_note(scene, experiment), out / RUN_FILE
    if geometry is not None:
        note['geometry'] = geometry.digest
    if path.exists():
        found = _read_run_note(path)
        found.pop('folder', None)  # It may have been moved.
        if geometry is None and (out / 'field.npz').exists():
            found.pop('geometry', None)  # It is read no more.
        if found != note and {**note, **found} == note:
            raise ConfigError(
                f'{out}: holds a run of an older neo_ros, which did not note all of that; choose '
                'another folder, or if photos, poses, floor map and view are still those it was '
                f'trained on, write this into {path}: {json.dumps(note)}')
        if found != note:
            raise ConfigError(f'{out}: expected an empty folder or a run of {note}, got a run '
                              f'of {found}; choose another folder, or give the experiment that it '
                              'was trained with, --config')
        return
    if any(path.name != PLAN_FILE for path in out.iterdir()):
        raise ConfigError(f'{out}: expected an empty folder or an earlier run; it holds '
                          'other files')
    if folder is not None:
        note['folder'] = str(folder.resolve())
    write_bytes(path, json.dumps(note).encode())


def begin_run(out: Path, minutes: float | None) -> None:
    """
    Forget the plan of a run that was refused before it began.

    Raises ConfigError where `out` holds a run of --minutes, and none are given, and where the
    file of that name is none of ours.
    """
    plan = out / PLAN_FILE
    if not plan.exists():
        return
    before = read_plan(out).minutes  # Somebody else's file is refused here, and stays.
    if not (out / RUN_FILE).exists():
        plan.unlink()
    elif minutes is None:
        raise ConfigError(f'--minutes: {out} holds a run of {before:g} minutes; give --minutes '
                          f'{before:g} again, or choose another folder')


@contextmanager
def free_where_refused(out: Path) -> Iterator[None]:
    """
    Take the claim to `out` back where a NeoError comes before anything was made there.

    The command as the error asks for it may be another run's: it finds the folder free.
    """
    try:
        yield
    except NeoError:
        if {path.name for path in out.iterdir()} <= {RUN_FILE, PLAN_FILE}:
            for name in (RUN_FILE, PLAN_FILE):
                (out / name).unlink(missing_ok=True)
        raise


def note_update(out: Path, run: Path, scene: Scene) -> None:
    """Note in a new folder that it holds the run in the folder `run`, of more photos."""
    note = {**_read_run_note(run / RUN_FILE), **_scene_note(scene)}
    note.pop('folder', None)
    write_bytes(out / RUN_FILE, json.dumps(note).encode())


def scene_folder(run: Path) -> Path:
    """Return the scene that a run was trained on: in its folder, or where it was then."""
    note = _read_run_note(run / RUN_FILE)
    inside = run / str(note.get('scene'))
    if inside.is_dir():
        return inside
    if 'folder' not in note:
        raise ConfigError(f'{run / RUN_FILE}: does not say where the scene is: an older neo_ros '
                          'wrote it; name it with --scene')
    return Path(note['folder'])


def named_as_trained(scene: Scene, run: Path) -> Scene:
    """Give a scene the name that it had when a run was trained on it, which its files have."""
    if not (run / RUN_FILE).exists():
        return scene
    return replace(scene, name=str(_read_run_note(run / RUN_FILE).get('scene', scene.name)))


def check_run(run: Path, scene: Scene, experiment: Experiment, tuned: bool = False) -> None:
    """
    Raise ConfigError where a run is of other photos, or of other settings of the field.

    tuned: its network is to be trained on, so that all other settings count, too.
    """
    found = _read_run_note(run / RUN_FILE)
    own = {**_scene_note(scene), 'field': _field_hash(scene, experiment),
           'settings': _settings_hash(experiment)}
    found.setdefault('files', own['files'])  # An older neo_ros did not note them.
    photos = 'name its scene with --scene, with the photos that it was trained on'
    settings = 'give the experiment that it was trained with, --config'
    advice = {'photos': photos, 'files': photos, 'field': settings,
              **({'settings': settings} if tuned else {})}
    for name, what in advice.items():
        if found.get(name) != own[name]:
            raise ConfigError(f'{run}: expected a run of these photos and settings, it is one of '
                              f'other {name} ({found.get(name)}, not {own[name]}); {what}')


def _run_note(scene: Scene, experiment: Experiment) -> dict[str, Any]:
    view = experiment.expansion(scene.train.intrinsics, scene.expansion)
    return {'scene': scene.name, 'settings': _settings_hash(experiment),
            'field': _field_hash(scene, experiment), **_scene_note(scene),
            'view': f'{view.source.width}x{view.source.height} at {view.left}, {view.top} in '
                    f'{view.target.width}x{view.target.height}'}


def _settings_hash(experiment: Experiment) -> str:
    # Another memory leaves field and network as they are.
    return replace(experiment, memory=None).config_hash


def _field_hash(scene: Scene, experiment: Experiment) -> str:
    return experiment.field_hash(mapped=scene.walkable is not None)


def _scene_note(scene: Scene) -> dict[str, Any]:
    photos = scene.train
    beside = (path for path in (*photos.depth_paths, *photos.mask_paths) if path is not None)
    floors = None if scene.walkable is None else floors_digest((scene.walkable, *scene.upper))
    return {'photos': list_digest(photos)[:12],
            'files': files_digest((*photos.image_paths, *beside))[:12],
            'floor': None if floors is None else floors[:12]}


def _read_run_note(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text())
        if isinstance(found, dict):
            return found
        reason = f'got {found!r:.80}'
    except (OSError, ValueError) as error:
        reason = str(error)
    raise ConfigError(
        f'{path}: expected the note of an earlier run: {reason}; choose another folder')


def take_field(out: Path, scene: Scene, experiment: Experiment, other: Path) -> None:
    """
    Share the field of the run in the folder `other`, unless `out` has one.

    Raises ConfigError where it is of other photos or settings, or not finished.
    """
    if (out / 'field.npz').exists():
        return
    found, own = _read_run_note(other / RUN_FILE), _run_note(scene, experiment)
    differ = [name for name in ('photos', 'files', 'field') if found.get(name) != own[name]]
    if differ or not (other / 'field.npz').exists():
        reason = f'other {" and ".join(differ)}' if differ else 'no finished field'
        raise ConfigError(f'{other}: expected a run of the same photos and the same settings of '
                          f'field, scale and seed to take its field, got one of {reason}')
    drop_made_of_a_field(out)
    # The field last: where it is, its notes are.
    for name in ('field.json', 'field.npz'):
        share_file(other / name, out / name)


def drop_made_of_a_field(out: Path) -> None:
    """
    Delete what another field's training left, which would be taken for finished.

    What photos alone tell, points and stereo, stays: the folder is of the same photos.
    """
    for name in ('field.ckpt', 'outpainter.ckpt', NOTES):
        (out / name).unlink(missing_ok=True)
    for folder in (*out.glob('panoramas_*'), *out.glob(f'{WORK}/keyframes_*'), *out.glob(TILES)):
        shutil.rmtree(folder)
