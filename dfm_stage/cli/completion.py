"""completion: a script for the shell's start-up file that completes commands and options."""

from __future__ import annotations

import argparse
import importlib
import pkgutil

from dfm_stage import cli
from dfm_stage.cli.command import command, option
from dfm_stage.share import door

SHELLS = ("bash", "zsh", "fish")
EPILOG = """\
examples:
  ./run completion bash >> ~/.bashrc
  ./run completion zsh >> ~/.zshrc
  ./run completion fish > ~/.config/fish/completions/dfm-stage.fish
"""
OPTIONS = (option("shell", choices=SHELLS, help="the shell to write for"),)
BASH = """\
_dfm_stage() {{
    local words
    case "${{COMP_WORDS[1]}}" in
{cases}
    esac
    [ "$COMP_CWORD" = 1 ] && words="{names}"
    case "$COMP_CWORD ${{COMP_WORDS[COMP_CWORD]}}" in
        1\\ *|*\\ -*) COMPREPLY=($(compgen -W "$words" -- "${{COMP_WORDS[COMP_CWORD]}}")) ;;
    esac
}}
complete -o default -F _dfm_stage {door}
"""
ZSH = "autoload -Uz compinit bashcompinit && compinit && bashcompinit\n"


@command("completion", __doc__, EPILOG, OPTIONS)
def main(options: argparse.Namespace) -> int:
    """Print the lines; 0."""
    flags = flags_of_commands()
    print({"bash": bash, "zsh": lambda known: ZSH + bash(known), "fish": fish}[
        options.shell](flags), end="")
    return 0


def flags_of_commands() -> dict[str, list[str]]:
    """Return the long options of every command that this Python can start, by its name."""
    found = {}
    for module in pkgutil.iter_modules(cli.__path__):
        try:
            own = getattr(importlib.import_module(f"{cli.__name__}.{module.name}"), "main", None)
        except ModuleNotFoundError as error:    # the wheel does not bring what devices need
            if (error.name or "").partition(".")[0] == cli.__name__.partition(".")[0]:
                raise
            continue
        if own is not None:
            parser = getattr(own, "parser", argparse.ArgumentParser())
            found[module.name] = sorted(flag for action in parser._actions
                                        for flag in action.option_strings if flag[:2] == "--")
    return found


def bash(flags: dict[str, list[str]]) -> str:
    """Return the lines for bash."""
    cases = "\n".join(f'        {name}) words="{" ".join(own)}" ;;' for name, own in flags.items())
    return BASH.format(cases=cases, names=" ".join(flags), door=_program())


def fish(flags: dict[str, list[str]]) -> str:
    """Return the lines for fish."""
    program = _program()
    first = f"complete -c {program} -n __fish_use_subcommand -f -a '{' '.join(flags)}'"
    rest = [f"complete -c {program} -n '__fish_seen_subcommand_from {name}' -l {flag[2:]}"
            for name, own in flags.items() for flag in own]
    return "\n".join((first, *rest)) + "\n"


def _program() -> str:
    """The one word that commands begin with here; ros2 completes its own."""
    return door() if " " not in door() else "dfm-stage"
