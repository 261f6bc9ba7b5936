"""The package, installed by pip and by colcon, offers the same files in the same places."""
from importlib.util import find_spec
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import tomllib
from xml.etree import ElementTree

import neo_ros
import pytest

SOURCE = Path(neo_ros.__file__).parent.parent
pytestmark = [pytest.mark.slow, pytest.mark.skipif(
    not (SOURCE / 'setup.py').is_file(), reason='the tested neo_ros is not a source checkout')]
SHIPPED = ('launch', 'config', 'models')


def run(*command: str | Path, cwd: Path, **environment: str) -> subprocess.CompletedProcess:
    """Run a command that must succeed."""
    result = subprocess.run(command, cwd=cwd, env=os.environ | environment, text=True,
                            capture_output=True)
    assert result.returncode == 0, result.stdout + result.stderr
    return result


def copy_source(to: Path) -> Path:
    """Copy what a clone holds: a build leaves folders beside setup.py."""
    leave = shutil.ignore_patterns(
        '.*', '__pycache__', '*.egg-info', 'build', 'install', 'log', 'out')
    return Path(shutil.copytree(SOURCE, to, ignore=leave))


def pip_install(folder: Path) -> Path:
    """Install with pip, offline, into a prefix of its own."""
    prefix = folder / 'prefix'
    run(sys.executable, '-m', 'pip', 'install', '--no-deps', '--no-build-isolation', '--no-index',
        '--ignore-installed', '--prefix', prefix, copy_source(folder / 'source'), cwd=folder)
    return prefix


def colcon_build(folder: Path, *options: str) -> Path:
    """Build a workspace that holds only this package."""
    if find_spec('colcon_ros') is None:
        pytest.skip('colcon is not installed (extra dev)')
    copy_source(folder / 'src' / 'neo_ros')
    run(sys.executable, '-c', 'from colcon_core.command import main; main()',
        'build', *options, cwd=folder, AMENT_PREFIX_PATH=sys.prefix,
        CMAKE_PREFIX_PATH=sys.prefix)
    return folder / 'install' / 'neo_ros'


@pytest.fixture(scope='module', params=['pip', 'colcon', 'colcon --symlink-install'])
def prefix(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('installed')
    if request.param == 'pip':
        return pip_install(folder)
    return colcon_build(folder, *request.param.split()[1:])


def test_the_ament_index_knows_the_package(prefix: Path) -> None:
    assert (prefix / 'share/ament_index/resource_index/packages/neo_ros').is_file()
    assert (prefix / 'share/neo_ros/package.xml').is_file()


def files_below(folder: Path) -> set[Path]:
    """Return the relative paths of all files but what Python itself leaves behind."""
    return {path.relative_to(folder) for path in folder.rglob('*')
            if path.is_file() and '__pycache__' not in path.parts}


@pytest.mark.parametrize('folder', SHIPPED)
def test_all_shipped_files_are_in_share(prefix: Path, folder: str) -> None:
    shipped = files_below(SOURCE / folder)
    assert shipped, f'{folder}/ is empty'
    assert files_below(prefix / 'share/neo_ros' / folder) == shipped


def test_the_package_runs_from_its_installation(prefix: Path) -> None:
    code = ('from neo_ros.machine.files import share_dir; '
            'import neo_ros.flat.light as light; '
            'print(share_dir()); print(light.__file__)')
    share, module = run(sys.executable, '-c', code, cwd=prefix, **environment(prefix)
                        ).stdout.split()
    in_source = Path(module).resolve().is_relative_to(prefix.parents[1] / 'src')
    assert Path(share) == (prefix / 'share/neo_ros') or in_source, 'symlinks lead to the source'
    assert files_below(SOURCE / 'neo_ros') <= files_below(Path(module).parents[1])


def test_ros2_run_finds_the_node_and_it_starts(prefix: Path) -> None:
    node = prefix / 'lib/neo_ros/fov_extrapolator'
    assert os.access(node, os.X_OK)
    assert {path.name for path in node.parent.iterdir()} == {node.name, 'viewer'}
    assert os.access(node.with_name('viewer'), os.X_OK)
    # rclpy names the argument it does not know: the executable has come as far as to start ROS.
    result = subprocess.run([node, '--ros-args', '--no-such-argument'], text=True,
                            capture_output=True, env=os.environ | environment(prefix))
    assert 'no-such-argument' in result.stderr and 'UnknownROSArgsError' in result.stderr


def test_neo_is_on_the_path(prefix: Path) -> None:
    text = run(prefix / 'bin/neo', '--help', cwd=prefix, **environment(prefix)).stdout
    assert 'neo import' in text


def environment(prefix: Path) -> dict[str, str]:
    """Return the variables that sourcing the setup files of this prefix would set."""
    packages = next((prefix / 'lib').glob('python3*/site-packages'), prefix)
    build = prefix.parents[1] / 'build/neo_ros'
    return {'PYTHONPATH': os.pathsep.join(map(str, (build, packages))),
            'AMENT_PREFIX_PATH': str(prefix)}


def test_the_versions_agree() -> None:
    manifest = ElementTree.parse(SOURCE / 'package.xml')
    setup = run(sys.executable, 'setup.py', '--quiet', '--version', cwd=SOURCE).stdout.split()[-1]
    newest = re.search(r'^(\d+\.\d+\.\d+) \(.*\)\n-+$', (SOURCE / 'CHANGELOG.rst').read_text(),
                       re.MULTILINE)
    assert newest is not None
    assert {manifest.findtext('version'), setup, newest[1]} == {neo_ros.__version__}


def test_the_manifest_is_valid() -> None:
    catkin_pkg = pytest.importorskip('catkin_pkg.package', reason='comes with colcon-ros')
    warnings: list[str] = []
    package = catkin_pkg.parse_package_string(
        (SOURCE / 'package.xml').read_text(), filename='package.xml', warnings=warnings)
    assert package.package_format == 3 and warnings == []


def test_a_sourced_ros_keeps_the_ros_of_pypi_out() -> None:
    code = ('import setuptools; setuptools.setup = lambda **found: print('
            'any("rclpy" in name for name in found["install_requires"])); import setup')
    clean = {name: value for name, value in os.environ.items()
             if name not in ('ROS_DISTRO', 'AMENT_PREFIX_PATH')}
    for sourced, expected in (({}, 'True'), ({'ROS_DISTRO': 'jazzy'}, 'False')):
        result = subprocess.run([sys.executable, '-c', code], cwd=SOURCE, env=clean | sourced,
                                capture_output=True, text=True)
        assert result.stdout.strip() == expected, result.stderr


def test_every_requirement_has_a_pinned_version() -> None:
    pinned = {line.split('==')[0].replace('_', '-').lower()
              for line in (SOURCE / 'constraints.txt').read_text().splitlines() if '==' in line}
    code = ('import setuptools; setuptools.setup = lambda **found: print(*found['
            '"install_requires"], *sum(found["extras_require"].values(), [])); import setup')
    clean = {name: value for name, value in os.environ.items()
             if name not in ('ROS_DISTRO', 'AMENT_PREFIX_PATH')}
    result = subprocess.run([sys.executable, '-c', code], cwd=SOURCE, env=clean,
                            capture_output=True, text=True, check=True)
    required = {re.split(r'[\[<>=]', name)[0].lower() for name in result.stdout.split()}
    build = tomllib.loads((SOURCE / 'pyproject.toml').read_text())['build-system']['requires']
    required |= {re.split(r'[\[<>=]', name)[0] for name in build}
    assert required - pinned == set()
