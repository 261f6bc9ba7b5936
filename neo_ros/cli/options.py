"""Options that do not go together."""
from neo_ros.errors import ConfigError


def refuse(why: str, **options: object) -> None:
    """Raise ConfigError for options that were given (not None or False) and would be ignored."""
    given = [f'--{name.replace("_", "-")}' for name, value in options.items()
             if value is not None and value is not False]
    if given:
        raise ConfigError(f'{", ".join(given)}: {why}; leave it out')
