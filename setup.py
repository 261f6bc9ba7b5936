"""Build neo_ros with pip or, in a ROS 2 workspace, with colcon."""
from glob import glob
import os

from setuptools import find_packages, setup

NAME = 'neo_ros'
ROBOT = [
    'jinja2',
    'lz4',
    'mcap',
    'numpy',
    'onnxruntime',
    'opencv-python-headless',
    'pydantic>=2',
    'pyyaml',
    'rich',
    'rosbags>=0.11',
    'typer',
    'zstandard',
]
# A sourced ROS 2 brings its own rclpy and messages; a second ROS from PyPI beside it would mix
# two sets of native libraries in one process.
if 'ROS_DISTRO' not in os.environ and 'AMENT_PREFIX_PATH' not in os.environ:
    ROBOT += ['ros-jazzy-common-interfaces', 'ros-jazzy-rclpy[fastrtps]']
TEST = ['hypothesis', 'pytest', 'pytest-timeout']
EXTRAS = {
    'train': ['numba', 'onnx', 'onnxscript', 'scipy', 'torch'],
    'bench': ['scikit-image'],
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
        # colcon calls `setup.py install`, which later versions refuse.
        'setuptools<80',
        'types-PyYAML',
    ],
}


def version() -> str:
    """Read the version where the package states it, without importing the package."""
    namespace: dict[str, str] = {}
    with open('neo_ros/__init__.py', encoding='utf-8') as source:
        exec(source.read(), namespace)
    return namespace['__version__']


setup(
    name=NAME,
    version=version(),
    description='Widens the view of a camera to what the scene really shows outside the frame',
    license='Apache-2.0',
    maintainer='neo_ros maintainers',
    maintainer_email='maintainers@neo-ros.example',
    python_requires='>=3.12',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['**/*.npz']},
    install_requires=ROBOT,
    extras_require=EXTRAS,
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        *[(f'share/{NAME}/{folder}', sorted(filter(os.path.isfile, glob(f'{folder}/*'))))
          for folder in ('launch', 'config', 'models')],
        (f'lib/{NAME}', ['scripts/fov_extrapolator']),
    ],
    entry_points={'console_scripts': [
        'neo = neo_ros.cli.main:main',
        'fov_extrapolator = neo_ros.node.main:main',
    ]},
    zip_safe=False,
)
