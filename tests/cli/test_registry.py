"""One module states everything about a command: its word, its options, its function; the rest loops over the registry."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest
from package_source import literals

import clacad.cli
from clacad.cli import main
from clacad.cli.command import GROUPS, BadUsage, Common, commands, find, parameters, scan

PACKAGE = Path(__file__).parents[2] / "clacad"
KNOWN = {one.word: one for one in commands()}

TOY = '''"""`clacad toy`: a command of the tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from clacad.cli.command import Command, flag, option, required
from clacad.cli.console import Console


@dataclass(frozen=True, kw_only=True)
class Toy:
    """Wind a toy and let it run."""

    toy: Path = required("TOY", "What is wound.")
    others: tuple[str, ...] = option("OTHERS...", "What is wound after it.", ())
    turns: int = option("-t, --turns N", "Turns of the key.", 3, least=1, most=9)
    colours: tuple[str, ...] = option("--colour C", "Repeatable.", ())
    loud: bool = flag("-l, --loud", "With noise.")
    wheels: bool = option("--wheels/--no-wheels", "On wheels.", True)
    metres: float | None = option("--metres X", "How far.")


def run(request: Toy, console: Console) -> int:
    """Print the request."""
    console.show(lambda: {"toy": str(request.toy)}, lambda: repr(request))
    return 0


COMMANDS = (Command("toy", "look", Toy, run),)
'''


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    (tmp_path / "toy_command.py").write_text(TOY)
    monkeypatch.setattr(clacad.cli, "__path__", [*clacad.cli.__path__, str(tmp_path)])
    yield
    sys.modules.pop("clacad.cli.toy_command", None)


@pytest.mark.parametrize("word", KNOWN)
def test_the_word_of_a_command_is_a_literal_of_its_own_module_alone(word: str) -> None:
    own = KNOWN[word].run.__module__.rpartition(".")[2]
    assert [own] == [path.stem for path in sorted((PACKAGE / "cli").glob("*.py")) if word in literals(path)]


def test_every_command_that_a_message_names_exists() -> None:
    named = {
        (path.name, word)
        for path in PACKAGE.rglob("*.py")
        for word in re.findall(r"`clacad ([a-z]+)\b", path.read_text(encoding="utf-8"))
    }
    assert {word for _, word in named} <= set(KNOWN), named


@pytest.mark.parametrize("command", KNOWN.values(), ids=lambda command: command.word)
def test_a_command_is_a_frozen_dataclass_of_documented_options_and_a_function(command) -> None:
    assert is_dataclass(command.request)
    assert command.request.__dataclass_params__.frozen
    assert command.group in GROUPS
    assert command.sentence.endswith(".")
    known = parameters(command.request)
    assert [one.name for one in known] == [one.name for one in fields(command.request)]
    assert all(one.help for one in known)
    flags = [flag for one in [*known, *parameters(Common)] for flag in (*one.flags, *one.opposites)]
    assert len(set(flags)) == len(flags)


# -- a new command is one new module -------------------------------------------------------------------------


def test_a_new_module_is_in_the_help_the_completion_and_the_explanations(toy, capsys) -> None:
    from clacad.cli.completion import complete

    assert main(["--help"]) == 0
    assert "  toy        Wind a toy and let it run.\n" in capsys.readouterr().out
    assert main(["toy", "--help"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("Usage: clacad toy [OPTIONS] {TOY} [OTHERS...]\n\n  Wind a toy and let it run.\n")
    for line in (
        "TOY        What is wound.  [required]",
        "-t, --turns N           Turns of the key.  [default: 3; 1<=x<=9]",
        "--wheels / --no-wheels  On wheels.  [default: wheels]",
        "--metres X              How far.\n",
        "-q, --quiet             Errors only.\n",
    ):
        assert f"  {line}" in said
    assert main(["explain", "toy"]) == 0
    assert "command toy\n  Wind a toy and let it run.\n" in capsys.readouterr().out
    words = {"_CLACAD_COMPLETE": "complete_bash", "COMP_WORDS": "clacad to", "COMP_CWORD": "1"}
    assert complete(words) == ("tolerance\ntoy", 0)
    assert complete(words | {"COMP_WORDS": "clacad toy --w", "COMP_CWORD": "2"}) == ("--wheels", 0)
    line = {"_CLACAD_COMPLETE": "complete_zsh", "_TYPER_COMPLETE_ARGS": "clacad toy --tu"}
    assert complete(line) == ("""_arguments '*: :(("--turns":"Turns of the key."))'""", 0)
    line = {"_CLACAD_COMPLETE": "complete_fish", "_TYPER_COMPLETE_ARGS": "clacad toy "}
    assert complete(line | {"_TYPER_COMPLETE_FISH_ACTION": "is-args"}) == ("", 1)


def test_without_the_module_there_is_no_such_command(capsys) -> None:
    assert find("toy") is None
    assert main(["toy"]) == 2
    assert "No such command 'toy'." in capsys.readouterr().err


@pytest.mark.parametrize(("words", "fields"), [
    ("a", "toy=PosixPath('a'), others=(), turns=3, colours=(), loud=False, wheels=True, metres=None"),
    ("-t4 a b --no-wheels c -- -d", "others=('b', 'c', '-d'), turns=4, colours=(), loud=False, wheels=False"),
    ("-lt 5 a --metres=-1e3 --turns 6", "turns=6, colours=(), loud=True, wheels=True, metres=-1000.0"),
    ("--colour -red --colour=blue=2 -", "toy=PosixPath('-'), others=(), turns=3, colours=('-red', 'blue=2')"),
])  # fmt: skip
def test_words_become_the_fields_of_the_request(toy, capsys, words, fields) -> None:
    assert main(["toy", *words.split()]) == 0
    assert fields in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(("words", "sentence"), [
    ("", "Missing argument 'TOY'."),
    ("a --colour", "Option '--colour' requires an argument."),
    ("a --loud=1", "Option '--loud' does not take a value."),
    ("a -lx", "No such option: -x"),
    ("a --turn 3", "No such option: --turn (Possible options: --turns)"),
    ("a --turns x", "Invalid value for '-t' / '--turns': Input should be a valid integer, unable to parse string as an integer"),
    ("a --turns 0", "Invalid value for '-t' / '--turns': Input should be greater than or equal to 1"),
    ("a --turns 10", "Invalid value for '-t' / '--turns': Input should be less than or equal to 9"),
    ("a --metres far", "Invalid value for '--metres': Input should be a valid number, unable to parse string as a number"),
])  # fmt: skip
def test_a_wrong_word_is_named_with_the_help_to_ask_for(toy, capsys, words, sentence) -> None:
    assert main(["toy", *words.split()]) == 2
    assert capsys.readouterr().err == f"{sentence}\n  try: clacad toy --help\n"


def test_a_word_too_many_is_named() -> None:
    with pytest.raises(BadUsage, match=r"unexpected extra argument\(s\) \(c d\)"):
        scan(parameters(KNOWN["explain"].request), ["a", "c", "d"], "explain").request(
            KNOWN["explain"].request
        )


@pytest.mark.parametrize(
    "words", [["-q", "explain", "eta"], ["explain", "-q", "eta"], ["explain", "eta", "-q"]]
)
def test_quiet_is_heard_before_and_after_the_command(words, capsys) -> None:
    assert main(words) == 0
    assert capsys.readouterr() == ("", "")


# -- completion ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_installed_once_for_the_current_shell(shell, tmp_path, monkeypatch, capsys) -> None:
    from clacad.cli import completion

    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(completion, "_shell", lambda: shell)
    assert main(["--show-completion"]) == 0
    script = capsys.readouterr().out.strip()
    assert "_CLACAD_COMPLETE=complete_" in script
    for _ in range(2):
        assert main(["--install-completion"]) == 0
        assert f"{shell} completion installed in " in capsys.readouterr().out
    files = {path: path.read_text() for path in tmp_path.rglob("*") if path.is_file()}
    assert script in {text.strip() for text in files.values()}
    for rc in (path for path in files if path.name in (".bashrc", ".zshrc")):
        assert len(files[rc].splitlines()) == 1
