"""Completion of command lines in bash, zsh, fish and PowerShell: scripts for the shells, and what they call.

A shell runs the program with `_CLACAD_COMPLETE=complete_SHELL` and the line in other variables. The program
prints the words that fit.
"""

from __future__ import annotations

import os
import shlex
import subprocess
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from clacad.cli.command import PROGRAM, VARIABLE, Common, Start, commands, find, parameters
from clacad.cli.option_values import BadOption

BASH = r"""
_clacad_completion() {
    local IFS=$'\n'
    COMPREPLY=( $( env COMP_WORDS="${COMP_WORDS[*]}" \
                   COMP_CWORD=$COMP_CWORD \
                   _CLACAD_COMPLETE=complete_bash $1 ) )
    return 0
}

complete -o default -F _clacad_completion clacad
"""

ZSH = """
#compdef clacad

_clacad_completion() {
  eval $(env _TYPER_COMPLETE_ARGS="${words[1,$CURRENT]}" _CLACAD_COMPLETE=complete_zsh clacad)
}

compdef _clacad_completion clacad
"""

_FISH = (
    "env _CLACAD_COMPLETE=complete_fish _TYPER_COMPLETE_FISH_ACTION={} "
    "_TYPER_COMPLETE_ARGS=(commandline -cp) clacad"
)
FISH = (
    f'complete --command clacad --no-files --arguments "({_FISH.format("get-args")})" '
    f'--condition "{_FISH.format("is-args")}"'
)

POWERSHELL = """
Import-Module PSReadLine
Set-PSReadLineKeyHandler -Chord Tab -Function MenuComplete
$scriptblock = {
    param($wordToComplete, $commandAst, $cursorPosition)
    $Env:_CLACAD_COMPLETE = "complete_powershell"
    $Env:_TYPER_COMPLETE_ARGS = $commandAst.ToString()
    $Env:_TYPER_COMPLETE_WORD_TO_COMPLETE = $wordToComplete
    clacad | ForEach-Object {
        $commandArray = $_ -Split ":::"
        $command = $commandArray[0]
        $helpString = $commandArray[1]
        [System.Management.Automation.CompletionResult]::new(
            $command, $command, 'ParameterValue', $helpString)
    }
    $Env:_CLACAD_COMPLETE = ""
    $Env:_TYPER_COMPLETE_ARGS = ""
    $Env:_TYPER_COMPLETE_WORD_TO_COMPLETE = ""
}
Register-ArgumentCompleter -Native -CommandName clacad -ScriptBlock $scriptblock
"""

SCRIPTS = {"bash": BASH, "zsh": ZSH, "fish": FISH, "powershell": POWERSHELL, "pwsh": POWERSHELL}
"""Script of each shell. The names of variables are those of scripts that earlier releases installed."""


def show_completion() -> str:
    """Script of the current shell."""
    return SCRIPTS[_shell()].strip()


def install_completion() -> str:
    """Install the script of the current shell; the sentence to print."""
    shell, home = _shell(), Path.home()
    script = show_completion()
    if shell == "bash":
        file = home / ".bash_completions" / f"{PROGRAM}.sh"
        _add(home / ".bashrc", f"source '{file}'")
    elif shell == "zsh":
        file = home / ".zfunc" / f"_{PROGRAM}"
        _add(home / ".zshrc", "fpath+=~/.zfunc; autoload -Uz compinit; compinit")
    elif shell == "fish":
        file = home / ".config" / "fish" / "completions" / f"{PROGRAM}.fish"
    else:
        line = [shell, "-NoProfile", "-Command", "echo $profile"]
        file = Path(subprocess.run(line, check=True, capture_output=True, text=True).stdout.strip())
    if shell in ("bash", "zsh", "fish"):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"{script}\n", encoding="utf-8")
    else:
        _add(file, script)
    return (
        f"{shell} completion installed in {file}\nCompletion will take effect once you restart the terminal"
    )


def _shell() -> str:
    """Name of the shell that started the program, or of the user's own.

    Raises BadOption: A shell without a script.
    """
    names = ["powershell"] if os.name == "nt" else [Path(os.environ.get("SHELL", "")).name]
    with suppress(OSError):  # there is no such file but on Linux
        names.insert(0, Path(f"/proc/{os.getppid()}/comm").read_text(encoding="utf-8").strip())
    for name in names:
        if name in SCRIPTS:
            return name
    raise BadOption(f"shell {names[-1]!r}: no completion; there is one for {', '.join(SCRIPTS)}")


def _add(file: Path, lines: str) -> None:
    """Append lines to a shell's start file unless it holds them."""
    text = file.read_text(encoding="utf-8") if file.is_file() else ""
    if lines not in text:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"{text}{lines}\n", encoding="utf-8")


# -- what the shells call ------------------------------------------------------------------------------------


def complete(variables: Mapping[str, str]) -> tuple[str, int]:
    """Text to print for a shell's request, and the exit status."""
    shell = variables[VARIABLE].partition("_")[2]
    if shell == "bash":
        before = _split(variables.get("COMP_WORDS", ""))
        place = int(variables.get("COMP_CWORD", "0"))
        before, last = before[1:place], before[place] if place < len(before) else ""
    else:
        line = variables.get("_TYPER_COMPLETE_ARGS", "")
        before, last = _split(line)[1:], variables.get("_TYPER_COMPLETE_WORD_TO_COMPLETE", "")
        if before and not line.endswith(" "):
            last = before.pop()
    found = {word: about for word, about in _candidates(before, last).items() if word.startswith(last)}
    if shell == "zsh":
        rows = "\n".join(f'"{_escaped(word)}":"{_escaped(about)}"' for word, about in found.items())
        return f"_arguments '*: :(({rows}))'" if rows else "_files", 0
    if shell == "fish" and variables.get("_TYPER_COMPLETE_FISH_ACTION") == "is-args":
        return "", 0 if found else 1
    join = {"fish": "\t", "powershell": ":::", "pwsh": ":::"}.get(shell)
    return "\n".join(word if join is None else f"{word}{join}{about}" for word, about in found.items()), 0


def _candidates(before: list[str], last: str) -> dict[str, str]:
    """Words that may follow, with their help: commands, or the options of the command."""
    word = next((text for text in before if not text.startswith("-")), None)
    if word is None and not last.startswith("-"):
        return {one.word: one.sentence for one in sorted(commands(), key=lambda one: one.word)}
    command = None if word is None else find(word)
    if not last.startswith("-") or (word is not None and command is None):
        return {}
    known = [*parameters(Start if command is None else command.request), *parameters(Common)]
    return {flag: one.help for one in known for flag in (*one.flags, *one.opposites)}


def _split(line: str) -> list[str]:
    """Words of a line that may end within quotes."""
    for end in ("", "'", '"'):
        with suppress(ValueError):
            return shlex.split(line + end)
    return line.split()


def _escaped(text: str) -> str:
    """A text between double quotes within single quotes of zsh."""
    for sign, instead in (('"', '""'), ("'", "''"), ("$", r"\$"), ("`", r"\`"), (":", r"\\:")):
        text = text.replace(sign, instead)
    return text
