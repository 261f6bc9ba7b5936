"""`python -m neo_ros.documents`: write all generated blocks and plots of docs/ anew."""
from pathlib import Path

from neo_ros.documents.pages import filled, pages
from neo_ros.documents.reference import MAKERS as REFERENCE
from neo_ros.documents.results import MAKERS as RESULTS, PLOTS


def write_documents(root: Path) -> None:
    """Write the pages and plots of the checkout `root`."""
    for path in pages(root):
        path.write_text(filled(path.read_text(), root, {**REFERENCE, **RESULTS}))
    for name, draw in PLOTS.items():
        (root / 'docs' / 'results' / name).write_bytes(draw(root))


if __name__ == '__main__':
    write_documents(Path.cwd())
