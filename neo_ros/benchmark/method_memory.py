"""
How much memory a method takes: a process of its own loads it and widens a few frames.

    python -m neo_ros.benchmark.method_memory FOLDER METHOD

FOLDER is a benchmark's working folder in which the method is ready. Prints by how many MB the
process grew at its peak; the interpreter and the libraries were loaded before and do not count.
"""
from importlib import import_module
from importlib.util import find_spec
import json
from pathlib import Path
import re
import subprocess
import sys

from neo_ros.machine.progress import no_stage_progress

FRAMES = 3


def measure_memory(folder: Path, method: str) -> float | None:
    """Return the growth of the resident memory in MB, None where the system does not tell."""
    command = [sys.executable, '-m', 'neo_ros.benchmark.method_memory', str(folder), method]
    result = subprocess.run(command, capture_output=True, text=True)
    lines = result.stdout.split()
    return float(lines[-1]) if result.returncode == 0 and lines else None


def main() -> None:
    """Load the method of the arguments, use it, and print the peak."""
    from neo_ros.benchmark.methods import make_method
    from neo_ros.evaluation.evaluate import run_method
    from neo_ros.benchmark.workbench import Job, Workbench

    folder, name = Path(sys.argv[1]), sys.argv[2]
    job = Job(**json.loads((folder / 'job.json').read_text())['job'])
    bench = Workbench(job, folder, no_stage_progress)
    # What methods import only when they are made.
    for module in ('pycolmap', 'scipy.ndimage', 'neo_ros.memory.guided_view'):
        if find_spec(module):
            import_module(module)
    before = resident_mb('VmRSS')
    method = make_method(name, bench)
    for index in range(min(FRAMES, len(bench.frames))):
        run_method(method, bench.frames, index, bench.frames.read(index)[0])
    print(max(resident_mb('VmHWM') - before, 0.0))


def resident_mb(key: str) -> float:
    """Return VmRSS (now) or VmHWM (at its peak) of this process, MB; Linux alone tells."""
    found = re.search(rf'{key}:\s*(\d+) kB', Path('/proc/self/status').read_text())
    if found is None:
        raise OSError(f'/proc/self/status has no {key}')
    return int(found[1]) / 1e3


if __name__ == '__main__':
    main()
