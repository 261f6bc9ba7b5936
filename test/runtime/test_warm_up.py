"""Nothing is compiled while images come."""
from pathlib import Path
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

HELPERS = Path(__file__).parents[1] / 'helpers'
# In a process of its own: the tests before have compiled everything.
WALK = """
import sys
import tempfile
from pathlib import Path
from box_room import planar, SOURCE, view, write_box_model
from neo_ros.runtime import FovExtrapolator
from numba.core.registry import CPUDispatcher

def compiled():
    return {f'{module.__name__}.{name}': len(kernel.signatures)
            for module in list(sys.modules.values()) if 'neo_ros.memory' in str(module)
            for name, kernel in vars(module).items() if isinstance(kernel, CPUDispatcher)}

extrapolator = FovExtrapolator.load(write_box_model(Path(tempfile.mkdtemp())))
before = compiled()
walk = [planar(1.9 + 0.02 * step, 1.7, 35 + step) for step in range(4)]
shown = [extrapolator.expand(view(pose, SOURCE)[0]) for pose in walk]
assert all(one.guided for one in shown), 'the walk is not guided'
assert len(before) > 10, before
new = {name for name, count in compiled().items() if count > before.get(name, 0)}
assert not new, f'compiled while images came: {sorted(new)}'
"""


def test_a_guided_walk_compiles_nothing() -> None:
    done = subprocess.run([sys.executable, '-c', WALK], cwd=HELPERS, capture_output=True,
                          text=True, check=False)
    assert done.returncode == 0, done.stderr
