"""
Pages of docs/ with blocks that are generated.

A block stands between `<!-- begin NAME ARGUMENT... -->` and `<!-- end -->`; all around it is
written by hand.
"""
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
import re

from neo_ros.errors import NeoError

BLOCK = re.compile(r'(?P<begin><!-- begin (?P<call>[^>]*?) -->\n).*?(?P<end><!-- end -->)', re.S)
# From the checkout and the arguments to Markdown without a last newline.
Maker = Callable[..., str]


def pages(root: Path) -> Iterator[Path]:
    """Yield the pages of a checkout that hold a generated block."""
    for path in sorted(root.glob('docs/**/*.md')):
        if BLOCK.search(path.read_text()):
            yield path


def filled(text: str, root: Path, makers: Mapping[str, Maker]) -> str:
    """Return a page with all of its blocks made anew."""
    def fill(match: re.Match[str]) -> str:
        name, *arguments = match['call'].split()
        if name not in makers:
            raise NeoError(f'begin {match["call"]}: expected one of {", ".join(sorted(makers))}')
        return f'{match["begin"]}\n{makers[name](root, *arguments)}\n\n{match["end"]}'
    return BLOCK.sub(fill, text)


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown, without a last newline."""
    lines = [head, ['---'] * len(head), *rows]
    return '\n'.join('| ' + ' | '.join(line) + ' |' for line in lines)
