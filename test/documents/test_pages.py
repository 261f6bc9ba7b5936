"""The pages of docs/: what is generated is what results and code say, and every link leads on."""
from importlib.metadata import version
from pathlib import Path
import re
from typing import Any

import neo_ros
from neo_ros.documents.pages import filled, pages, table
from neo_ros.documents.reference import MAKERS as REFERENCE
from neo_ros.documents.results import MAKERS as RESULTS, PLOTS
from neo_ros.errors import NeoError
import pytest

ROOT = Path(neo_ros.__file__).parent.parent
MAKERS = {**REFERENCE, **RESULTS}
PAGES = list(pages(ROOT))
WRITTEN = [path for pattern in ('*.md', 'docs/**/*.md', 'results/*.md')
           for path in sorted(ROOT.glob(pattern))]
LINK = re.compile(r'\[[^\]]*\]\(([^)\s]+)\)')

needs_checkout = pytest.mark.skipif(
    not (ROOT / 'docs').is_dir(), reason='the tested neo_ros is not a source checkout')


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_blocks_are_made_anew_and_the_rest_stays() -> None:
    makers = {'count': lambda root, *words: f'{root} {len(words)}'}
    text = 'a\n<!-- begin count x y -->\nold\n<!-- end -->\nb\n<!-- begin count --><!-- end -->'
    made = filled(text, Path('here'), makers)
    assert made == ('a\n<!-- begin count x y -->\n\nhere 2\n\n<!-- end -->\nb\n'
                    '<!-- begin count --><!-- end -->')
    assert filled(made, Path('here'), makers) == made


def test_a_block_that_nobody_makes_is_named() -> None:
    with pytest.raises(NeoError, match='begin cuont x: expected one of count, sum'):
        filled('<!-- begin cuont x -->\n<!-- end -->', Path(),
               {'count': lambda root: '', 'sum': lambda root: ''})


def test_a_table_is_markdown() -> None:
    assert table(['a', ''], [['1', '2']]) == '| a |  |\n| --- | --- |\n| 1 | 2 |'


@needs_checkout
@pytest.mark.parametrize('path', PAGES, ids=name_of)
def test_a_generated_page_is_current(path: Path) -> None:
    text = path.read_text()
    try:
        made = filled(text, ROOT, MAKERS)
    except ModuleNotFoundError as error:
        pytest.skip(f'{error.name} is not installed')
    assert text == made, f'{name_of(path)} is stale: make docs'


@needs_checkout
@pytest.mark.parametrize('name', PLOTS)
def test_a_plot_is_current(name: str) -> None:
    pytest.importorskip('matplotlib')
    pinned = re.search(r'^matplotlib==(.*)$', (ROOT / 'constraints.txt').read_text(), re.M)
    if pinned is None or version('matplotlib') != pinned[1]:
        pytest.skip('another matplotlib than that of constraints.txt draws other bytes')
    kept = ROOT / 'docs' / 'results' / name
    assert kept.read_bytes() == PLOTS[name](ROOT), f'{name_of(kept)} is stale: make docs'


def anchors(path: Path) -> set[str]:
    """Return the anchors that GitHub gives to the headings of a page."""
    headings = re.findall(r'^#+ (.*)$', path.read_text(), re.M)
    return {re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-') for heading in headings}


@needs_checkout
@pytest.mark.parametrize('path', WRITTEN, ids=name_of)
def test_every_link_leads_to_a_file(path: Path) -> None:
    broken = []
    for link in LINK.findall(path.read_text()):
        if re.match('[a-z]+:', link):
            continue
        file, _, anchor = link.partition('#')
        target = (path.parent / file) if file else path
        if not target.exists() or anchor and anchor not in anchors(target):
            broken.append(link)
    assert broken == []


# A line of its own, or code within a sentence.
COMMAND = re.compile(
    r'^    (?:.*-m neo_ros\.cli\.main|(?:\.venv/bin/)?neo) (.*)$|`neo ([^`]*)`', re.M)


def commands_of(path: Path) -> list[str]:
    """Return the `neo` commands of a page, without `neo` and what stands behind a #."""
    text = path.read_text().replace('\\\n', ' ')
    return [' '.join((line or code).split('  #')[0].split())
            for line, code in COMMAND.findall(text)]


@needs_checkout
@pytest.mark.parametrize('path', [path for path in WRITTEN if commands_of(path)], ids=name_of)
def test_commands_of_a_page_have_the_options_that_it_names(path: Path) -> None:
    from neo_ros.cli.main import app
    import typer
    group: Any = typer.main.get_command(app)
    known = {name: {option for parameter in command.params for option in parameter.opts}
             for name, command in group.commands.items()}
    known['COMMAND'] = {'--help'}
    for line in commands_of(path):
        assert line.split()[0] in known, line
        assert set(re.findall(r'(?<!\S)--[a-z-]+', line)) <= known[line.split()[0]], line


@needs_checkout
@pytest.mark.parametrize('name, most', [('README.md', 90), ('docs/STATUS.md', 60)])
def test_what_everybody_reads_is_short(name: str, most: int) -> None:
    assert len((ROOT / name).read_text().splitlines()) <= most


@needs_checkout
def test_decisions_are_short_and_numbered_without_gaps() -> None:
    found = sorted(ROOT.glob('docs/decisions/0*.md'))
    assert [int(path.name[:4]) for path in found] == list(range(1, len(found) + 1))
    index = (ROOT / 'docs/decisions/README.md').read_text()
    for path in found:
        assert len(path.read_text().splitlines()) <= 40 and path.name in index, path.name


@needs_checkout
def test_every_key_of_an_experiment_has_its_meaning() -> None:
    page = (ROOT / 'docs/reference/experiment.md').read_text()
    rows = [line.split(' | ') for line in page.splitlines() if line.startswith('| `')]
    assert len(rows) > 50
    assert [cells[0] for cells in rows if not cells[-1].strip(' |')] == []


@needs_checkout
@pytest.mark.parametrize('path', WRITTEN, ids=name_of)
def test_modules_that_a_page_names_are_there(path: Path) -> None:
    named = re.findall(r'`((?:[a-z_0-9]+/)*[a-z_0-9]+\.py)`', path.read_text())
    assert [name for name in named
            if not any((ROOT / start / name).is_file() for start in ('', 'neo_ros'))] == []
