"""The methods that can be benchmarked, by name; adding one is one file and one entry here."""
from collections.abc import Callable
from dataclasses import dataclass

from neo_ros.benchmark.field_view import FieldView, Oracle
from neo_ros.benchmark.relocalized import Relocalized, RelocalizedNeo, Relocalizer
from neo_ros.benchmark.warping import Warping
from neo_ros.benchmark.workbench import Workbench
from neo_ros.errors import ConfigError
from neo_ros.evaluation.baselines import EdgeReplication, MeanImage, Method, NeoModel


@dataclass(frozen=True)
class Entry:
    """
    What a method is, in words, and how it is made: `make` trains or builds what it needs.

    bound: a floor or an upper bound, no rival. field: it needs the radiance field.
    """

    words: str
    make: Callable[[Workbench], Method]
    bound: bool = False
    field: bool = True


def check_methods(names: list[str]) -> list[str]:
    """Return the names; raises ConfigError for one that does not exist, or none."""
    unknown = [name for name in names if name not in METHODS]
    if unknown or not names:
        raise ConfigError(f'methods: expected some of {", ".join(METHODS)}, got '
                          f'{", ".join(unknown) or "none"}')
    return names


def make_method(name: str, bench: Workbench) -> Method:
    """Train or build what a method needs, and return it ready to run."""
    check_methods([name])
    return METHODS[name].make(bench)


def _mean_image(bench: Workbench) -> Method:
    photos, scale = bench.scene.train, bench.base.scale
    return MeanImage(bench.expansion, (
        photos.read_shown(index, scale) for index in range(len(photos))))


def _warping(bench: Workbench) -> Method:
    bank, minutes = bench.bank()
    return Warping(bank, bench.expansion, minutes)


def _network(name: str) -> Callable[[Workbench], NeoModel]:
    def make(bench: Workbench) -> NeoModel:
        method = NeoModel(bench.model(name), name, guided=False)
        # Its model file also has the scene memory that `guided` goes by.
        method.train_minutes = method.card.trained_seconds / 60 - bench.memory_minutes(name)
        return method

    return make


def _guided(bench: Workbench) -> Method:
    return NeoModel(bench.model('neo_fast'), 'guided')


def _relocalized(bench: Workbench) -> tuple[Relocalized, float]:
    """Return B3, and the minutes that its map took, beside the field."""
    field, field_minutes, megabytes = bench.field()
    bank, bank_minutes = bench.bank()
    points, points_minutes = bench.sparse_model(bank)
    map_minutes = bank_minutes + points_minutes
    relocalizer = Relocalizer(bank, points, bench.expansion.source)
    return Relocalized(
        relocalizer, FieldView(field, bench.expansion), field_minutes + map_minutes,
        megabytes + bank.megabytes + points.megabytes), map_minutes


def _relocalized_neo(bench: Workbench) -> RelocalizedNeo:
    b3, map_minutes = _relocalized(bench)
    neo = _network('neo_fast')(bench)
    # The field's minutes are in the network's already.
    return RelocalizedNeo(b3, neo, (neo.train_minutes or 0) + map_minutes)


def _oracle(bench: Workbench) -> Method:
    field, minutes, megabytes = bench.field()
    return Oracle(FieldView(field, bench.expansion), minutes, megabytes)


# In the order of the tables.
METHODS = {
    'edge_replication': Entry('floor: the outermost observed pixels, repeated',
                              lambda bench: EdgeReplication(bench.expansion), True, False),
    'mean_image': Entry('floor: the mean training photo', _mean_image, True, False),
    'naive': Entry('B1: the same network, trained on resized photos',
                   lambda bench: NeoModel(bench.naive(), 'naive', guided=False), field=False),
    'warping': Entry('B2: similar photos, warped and blended', _warping, field=False),
    'relocalized': Entry('B3: estimated pose, the field renders',
                         lambda bench: _relocalized(bench)[0]),
    'neo_fast': Entry('NEO, fully connected middle', _network('neo_fast')),
    'mat': Entry('NEO, transformer after MAT', _network('mat')),
    'lama': Entry('NEO, Fourier convolutions after LaMa', _network('lama')),
    'relocalized_neo': Entry(
        'B3 and NEO: neo_fast where the field saw nothing or the pose is not found',
        _relocalized_neo),
    'guided': Entry('neo_fast with its scene memory: aligned to what it keeps of the scene',
                    _guided),
    'oracle': Entry('upper bound: the field at the true pose', _oracle, bound=True),
}
