"""Shell completion of commands, options and choices."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NoReturn, Union

import tyro

from .help import displayed


OPTION = "--tyro-print-completion"
# Without a proposal, tyro proposes an empty word, which keeps Bash from proposing files.
_FILES = """
_jaxcell() {
  _tyro_jaxcell "$@"
  [[ -n "${COMPREPLY[*]}" ]] || COMPREPLY=()
}
complete -o default -F _jaxcell jaxcell
"""


def print_completion(commands: Mapping[str, type], words: Sequence[str]) -> NoReturn:
    """Print the completion script for a shell, and exit."""
    try:
        tyro.cli(
            _tree(commands),
            args=list(words),
            prog="jaxcell",
            config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.FlagCreatePairsOff),
        )
    finally:
        if list(words[1:]) == ["bash"]:
            print(_FILES, end="")
    raise AssertionError("tyro exits after the script")


def _tree(commands: Mapping[str, type]) -> Any:
    """Build a union type of all commands, with a nested union for the commands of each group."""
    top = {name: displayed(kind) for name, kind in commands.items() if " " not in name}
    for group in dict.fromkeys(name.split()[0] for name in commands if " " in name):
        within = _choice(
            {
                name.split()[1]: displayed(kind)
                for name, kind in commands.items()
                if name.startswith(f"{group} ")
            }
        )
        alone = top.get(group)
        field = ("command", within) if alone is None else ("command", within | None, None)
        bases = () if alone is None else (alone,)
        top[group] = dataclasses.make_dataclass(
            group, [field], bases=bases, frozen=True, kw_only=True
        )
    return _choice(dict(sorted(top.items())))


def _choice(commands: Mapping[str, type]) -> Any:
    kinds = (Annotated[kind, tyro.conf.subcommand(name)] for name, kind in commands.items())
    return Union[tuple(kinds)]  # noqa: UP007
