"""The methods that can be benchmarked, by name; adding one is one file and one line here."""
from neo_ros.benchmark.workbench import Workbench
from neo_ros.errors import ConfigError
from neo_ros.evaluation.baselines import EdgeReplication, MeanImage, Method, NeoModel
from neo_ros.evaluation.field_view import FieldView, Oracle
from neo_ros.evaluation.relocalized import Relocalized, Relocalizer
from neo_ros.evaluation.warping import Warping

# Name and what it is, in the order of the tables.
METHODS = {
    'edge_replication': 'floor: the outermost observed pixels, repeated',
    'mean_image': 'floor: the mean training photo',
    'naive': 'B1: the same network, trained on resized photos',
    'warping': 'B2: similar photos, warped and blended',
    'relocalized': 'B3: estimated pose, the field renders',
    'neo_fast': 'NEO, fully connected middle',
    'mat': 'NEO, transformer after MAT',
    'lama': 'NEO, Fourier convolutions after LaMa',
    'guided': 'neo_fast with its scene memory: aligned to what it keeps of the scene',
    'oracle': 'upper bound: the field at the true pose',
}
NETWORKS = ('neo_fast', 'mat', 'lama')
WITHOUT_FIELD = ('edge_replication', 'mean_image', 'naive', 'warping')
BOUNDS = ('edge_replication', 'mean_image', 'oracle')  # no rivals: floors and upper bound


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
    if name == 'edge_replication':
        return EdgeReplication(bench.expansion)
    if name == 'mean_image':
        photos, scale = bench.scene.train, bench.base.scale
        return MeanImage(bench.expansion, (
            photos.read_image(index, scale) for index in range(len(photos))))
    if name == 'naive':
        return NeoModel(bench.naive(), name, guided=False)
    if name in NETWORKS:
        return NeoModel(bench.model(name), name, guided=False)
    if name == 'guided':
        return guided_model(bench)
    if name == 'warping':
        return Warping(bench.bank(), bench.expansion)
    field, minutes, megabytes = bench.field()
    view = FieldView(field, bench.expansion)
    if name == 'oracle':
        return Oracle(view, minutes, megabytes)
    bank = bench.bank()
    model = bench.sparse_model(bank)
    return Relocalized(Relocalizer(bank, model, bench.expansion.source), view, minutes,
                       megabytes + bank.megabytes)


def guided_model(bench: Workbench) -> NeoModel:
    """Return NEO with its memory; ConfigError where the model has none."""
    method = NeoModel(bench.model('neo_fast'), 'guided')
    if not method.guided:
        raise ConfigError('guided: the model of this scene has no memory; '
                          'leave it out of --methods')
    return method
