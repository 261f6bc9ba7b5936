"""`neo memory`: what a model has learnt of its scene since it was trained."""
from pathlib import Path
from typing import Annotated

import typer

memory = typer.Typer(no_args_is_help=True, help=(
    'What a model has learnt of its scene since it was trained (neo replay --learn, or learn of '
    'the node): info tells, compact takes out what was replaced, forget deletes it.'))
Model = Annotated[Path, typer.Argument(help='Model file (.onnx), its scene memory beside it.')]


@memory.command()
def info(model: Model) -> None:
    """Tell what the journal beside a scene memory holds."""
    import datetime

    from neo_ros.memory.journal import most_bytes, read_journal
    from neo_ros.memory.light_file import lights_path
    from neo_ros.memory.patch import Patch
    import rich
    from rich.markup import escape
    from rich.table import Table

    memory_file, journal, sha256 = _places(model)
    records = read_journal(journal, sha256)
    patches = [one for one in records if isinstance(one, Patch)]
    size = journal.stat().st_size if journal.exists() else 0
    table = Table('scene memory', escape(str(memory_file)))
    table.add_row('its size', f'{memory_file.stat().st_size / 1e6:.2f} MB')
    table.add_row('journal', escape(str(journal)) if size else 'none: nothing was learnt')
    if size:
        most = most_bytes(memory_file.stat().st_size)
        table.add_row('its size', f'{size / 1e6:.2f} MB, at most {most / 1e6:.2f} MB' + (
            ': full, neo memory compact makes room' if size >= most else ''))
        table.add_row('patches', f'{len(patches)}, of {len({one.batch for one in patches})} times')
        table.add_row('shown in another state', f'{len(records) - len(patches)} times')
    for name, patch in zip(('first learnt', 'last learnt'), (*patches[:1], *patches[-1:])):
        seen = datetime.datetime.fromtimestamp(patch.stamp_ns / 1e9)
        table.add_row(name, f'{seen:%Y-%m-%d %H:%M:%S}')
    lights = lights_path(memory_file)
    if lights.exists():
        table.add_row('lights it was seen in', f'{lights.stat().st_size / 1e6:.2f} MB')
    rich.print(table)


@memory.command()
def forget(model: Model) -> None:
    """Delete what was learnt: the scene is shown as it was trained."""
    from neo_ros.memory.journal import delete_learnt
    from neo_ros.memory.light_file import lights_path
    import rich
    from rich.markup import escape

    memory_file, journal, _ = _places(model)
    for path in (journal, lights_path(memory_file)):
        there = path.exists()
        delete_learnt(path)
        if there:
            rich.print(f'Forgotten: {escape(str(path))}')


@memory.command()
def compact(model: Model) -> None:
    """Take out of the journal what later patches have replaced."""
    from neo_ros.memory.journal import compact_journal, most_bytes
    import rich
    from rich.markup import escape

    memory_file, journal, sha256 = _places(model)
    if not journal.exists():
        rich.print('Nothing was learnt.')
        return
    size = journal.stat().st_size
    kept, before = compact_journal(journal, sha256, most_bytes(memory_file.stat().st_size))
    rich.print(f'{escape(str(journal))}: {len(kept)} of {before} records kept, '
               f'{size / 1e6:.2f} MB are {journal.stat().st_size / 1e6:.2f} MB now')


def _places(model: Path) -> tuple[Path, Path, str]:
    """Return memory, journal, and the memory's checksum; raises ModelError."""
    from neo_ros.errors import ModelError
    from neo_ros.memory.journal import journal_path
    from neo_ros.runtime.fov_extrapolator import memory_path
    from neo_ros.runtime.model_file import open_model

    card = open_model(model)[1]
    if card.memory is None:
        raise ModelError(f'{model}: expected a model with a scene memory; it has none, so it '
                         'cannot learn')
    path = memory_path(model, card.memory)
    if not path.exists():
        raise ModelError(f'{path}: expected the scene memory of {model.name}, there is none; copy '
                         'it beside the model')
    return path, journal_path(path), card.memory.sha256
