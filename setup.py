"""Build neo_ros with pip or, in a ROS 2 workspace, with colcon."""
from collections.abc import Iterator
import os
from pathlib import Path

from setuptools import find_packages, setup

NAME = 'neo_ros'
ROBOT = [
    'jinja2',
    'lz4',
    'matplotlib',
    'mcap>=1.6',
    # machine/compiled.py uses private parts; test/machine/test_compiled.py names what broke.
    'numba<0.69',
    'numpy',
    'onnxruntime',
    'opencv-python-headless',
    'pyyaml',
    'rich',
    # bags/qos.py uses more of it than its documented interface.
    'rosbags>=0.11,<0.12',
    'typer',
    'zstandard',
]
# A sourced ROS 2 brings its own rclpy and messages; a second ROS from PyPI beside it would mix
# two sets of native libraries in one process.
if 'ROS_DISTRO' not in os.environ and 'AMENT_PREFIX_PATH' not in os.environ:
    ROBOT += ['ros-jazzy-common-interfaces', 'ros-jazzy-rclpy[fastrtps]']
TEST = ['hypothesis', 'pytest', 'pytest-timeout', 'pytest-xdist']
EXTRAS = {
    'train': ['onnx', 'onnxscript', 'pycolmap', 'pydantic>=2', 'scipy', 'tensorboard', 'torch'],
    # Meshes in the place of a field, in `neo train --geometry`.
    'mesh': ['embreex', 'trimesh'],
    # Foxglove's own images, calibrations and transforms in protobuf.
    'foxglove': ['mcap-protobuf-support'],
    # Photos of phones, in `neo import`.
    'heic': ['pillow-heif'],
    # Depth of this app for phones, in `neo import`.
    'record3d': ['lzfse', 'OpenEXR'],
    # The page of `neo view`.
    'viewer': ['aiohttp'],
    # Video messages in bags, and the video of `neo replay --side-by-side`.
    'video': ['av'],
    # Many bags on several cores or machines, in `neo replay --cluster`.
    'cluster': ['ray'],
    # `colcon test` runs pytest when the extra of this name asks for it.
    'test': TEST,
    'dev': TEST + [
        'colcon-core',
        'colcon-ros',
        'flake8',
        'flake8-blind-except',
        'flake8-builtins',
        'flake8-class-newline',
        'flake8-comprehensions',
        'flake8-deprecated',
        'flake8-docstrings',
        'flake8-import-order',
        'flake8-quotes',
        'mypy',
        # Drives Debian's Chromium; without a browser its tests are skipped.
        'playwright',
        # Judges our SSIM.
        'scikit-image',
        # colcon calls `setup.py install`, which later versions refuse.
        'setuptools<80',
        'types-PyYAML',
    ],
}


def version() -> str:
    """Read the version where the package states it, without importing the package."""
    namespace: dict[str, str] = {}
    exec(Path(NAME, '__init__.py').read_text(encoding='utf-8'), namespace)
    return namespace['__version__']


def shared_files(*folders: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the share folder and the files of these folders and all folders below."""
    for top in folders:
        for folder, below, files in os.walk(top):
            below[:] = [name for name in below if name != '__pycache__']
            yield f'share/{NAME}/{folder}', [f'{folder}/{name}' for name in sorted(files)]


setup(
    name=NAME,
    version=version(),
    description='Widens the view of a camera to what the scene really shows outside the frame',
    license='Apache-2.0',
    maintainer='neo_ros maintainers',
    maintainer_email='maintainers@neo-ros.example',
    python_requires='>=3.12',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed', '**/*.npz', 'viewer/page/*']},
    install_requires=ROBOT,
    extras_require=EXTRAS,
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        *shared_files('config', 'launch', 'models'),
        (f'lib/{NAME}', ['scripts/fov_extrapolator', 'scripts/viewer']),
    ],
    entry_points={'console_scripts': [
        'neo = neo_ros.cli.main:main',
        'fov_extrapolator = neo_ros.node.main:main',
        'viewer = neo_ros.viewer.main:main',
    ]},
    zip_safe=False,
)
