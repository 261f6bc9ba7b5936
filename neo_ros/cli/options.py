"""Options that do not go together, and the command that comes next."""
import shlex

from neo_ros.errors import ConfigError
import typer


def refuse(why: str, **options: object) -> None:
    """Raise ConfigError for options that were given (not None or False) and would be ignored."""
    given = [f'--{name.replace("_", "-")}' for name, value in options.items()
             if value is not None and value is not False]
    if given:
        raise ConfigError(f'{", ".join(given)}: {why}; leave it out')


def tell_next(*words: object) -> None:
    """Print a command as it can be pasted: on one line, however narrow the terminal is."""
    typer.echo('Next: ' + shlex.join(map(str, words)))
