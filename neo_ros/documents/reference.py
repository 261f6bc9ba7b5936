"""Tables of docs/reference/ from the command line, the settings and the node's interface."""
import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from neo_ros.documents.pages import Maker, table
from neo_ros.errors import NeoError


def commands(root: Path) -> str:
    """Return all commands of `neo` with their arguments and options."""
    from neo_ros.cli.main import app
    import typer

    group = typer.main.get_command(app)
    parts = []
    for name, command in _all_commands(group, ''):
        lines = [[_names(parameter), _default(parameter),
                  _line(getattr(parameter, 'help', ''))] for parameter in command.params
                 if not getattr(parameter, 'hidden', False)]
        parts += [f'## neo{name}', _unwrapped(command.help or ''),
                  table(['argument or option', 'default', ''], lines)]
    return '\n\n'.join(parts)


def _all_commands(group: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield commands and groups with their names, each group before what is in it."""
    for word, command in group.commands.items():
        yield f'{name} {word}', command
        if hasattr(command, 'commands'):
            yield from _all_commands(command, f'{name} {word}')


def fields(root: Path, file: str, name: str, prefix: str = '') -> str:
    """Return the fields of a class: its source says name, type, default and a comment beside."""
    found, lines = _class(root / file, name)
    constants = {ast.unparse(node.targets[0]): node.value
                 for node in ast.parse((root / file).read_text()).body
                 if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)}
    rows = [[f'`{prefix}{ast.unparse(node.target)}`', _cell(ast.unparse(node.annotation)),
             _value(node.value, constants), _line(_comment(lines, node))]
            for node in found.body if isinstance(node, ast.AnnAssign)]
    return table(['key', 'type', 'default', ''], rows)


def words(root: Path, file: str, name: str) -> str:
    """Return what a class says of itself."""
    return ast.get_docstring(_class(root / file, name)[0]) or ''


def rooms(root: Path) -> str:
    """Return every room with what it owns and what the import law lets it use."""
    test = ast.parse((root / 'test' / 'test_import_law.py').read_text())
    law: dict[str, set[str]] = next(
        ast.literal_eval(node.value) for node in test.body
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == 'LAW' and node.value)
    rows = []
    for room, may in law.items():
        owns = ast.get_docstring(ast.parse((root / 'neo_ros' / room / '__init__.py').read_text()))
        modules = sorted(name for name in may if (root / 'neo_ros' / f'{name}.py').is_file())
        inner = [f'`{name}`' for name in (*sorted(may & law.keys()), *modules)]
        libraries = sorted(may - law.keys() - {*modules, 'cli'})
        if 'cli' in may:
            inner.append('`cli`')
        rows.append([f'`{room}`', _line((owns or '').split('\n\n')[0]), ', '.join(inner),
                     ', '.join(libraries)])
    return table(['room', 'owns', 'may import', 'heavy libraries'], rows)


def interface(root: Path, name: str) -> str:
    """Return the node's topics, parameters, services or diagnostics."""
    from neo_ros.node.interface_tables import interface_tables
    return interface_tables()[name].rstrip('\n')


MAKERS: dict[str, Maker] = {
    'commands': commands, 'fields': fields, 'words': words, 'rooms': rooms,
    'interface': interface}


def _class(path: Path, name: str) -> tuple[ast.ClassDef, list[str]]:
    """Return a class of a module, and the module's lines."""
    text = path.read_text()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ClassDef) and node.name == name:
            return node, text.splitlines()
    raise NeoError(f'{path}: expected the class {name}')


def _comment(lines: list[str], node: ast.AnnAssign) -> str:
    """Return the comment beside a field, or the lines of comment right above it."""
    assert node.end_lineno is not None
    _, mark, words = lines[node.end_lineno - 1].encode()[node.end_col_offset:].decode().partition(
        '# ')
    if mark and not words.startswith('noqa'):
        return words
    above: list[str] = []
    for line in reversed(lines[:node.lineno - 1]):
        if not line.strip().startswith('# '):
            break
        above.insert(0, line.strip()[2:])
    return ' '.join(above)


def _value(value: ast.expr | None, constants: dict[str, ast.Constant]) -> str:
    if value is None:
        return 'required'
    value = constants.get(ast.unparse(value), value)
    # A group of settings has defaults of its own.
    text = ast.unparse(value)
    return '' if isinstance(value, ast.Call) else f'`{text}`'


def _names(parameter: object) -> str:
    names = [*getattr(parameter, 'opts', ()), *getattr(parameter, 'secondary_opts', ())]
    if getattr(parameter, 'param_type_name', '') == 'argument':
        return f'`{getattr(parameter, "metavar", None) or names[0].upper()}`'
    return ', '.join(f'`{name}`' for name in names)


def _default(parameter: object) -> str:
    default = getattr(parameter, 'default', None)
    if getattr(parameter, 'required', False):
        return 'required'
    if default is None or default is False or default == [] or callable(default):
        return ''
    return f'`{getattr(default, "value", default)}`'


def _unwrapped(text: str) -> str:
    return '\n\n'.join(' '.join(part.split()) for part in text.replace('\b', '').split('\n\n'))


def _line(text: str | None) -> str:
    return _cell(' '.join((text or '').split()))


def _cell(text: str) -> str:
    return text.replace('|', r'\|')
