"""A person finds verbs, examples and pages from the command alone."""

from __future__ import annotations

import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from lab.cli import GROUPS, declared, main, parser

ROOT = Path(__file__).parents[2]
VERBS = [verb for group in GROUPS.values() for verb in group]


def test_the_verbs_are_listed_in_groups(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help"]) == 0
    told = capsys.readouterr().out
    assert main([]) == 2
    assert capsys.readouterr().out == told
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0 and capsys.readouterr().out == told
    places = [told.index(f"\n{title}:\n") for title in GROUPS]
    assert places == sorted(places) and "\n  recover " in told[places[2] : places[3]]
    assert [line.split()[0] for line in told.splitlines() if line.startswith("  ")] == VERBS


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["recovr", "a.mcap"], "did you mean recover?"),
        (["xyzzy"], "lab help lists"),
        (["help", "exprt"], "mean export?"),
    ],
)
def test_an_unknown_verb_is_answered_with_the_nearest(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    told = capsys.readouterr().err
    assert said in told and len(told.splitlines()) == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["replay", "a.mcap", "--sped", "5"], "lab replay --sped: is not an option; did you mean --speed?"),
        (["replay", "a.mcap", "--sped=5"], "lab replay --sped: is not an option; did you mean --speed?"),
        (["run", "-rig", "rig.yaml"], "lab run -rig: is not an option; did you mean --rig?"),
        (["safe", "--al"], "lab safe --al: is not an option; did you mean --all?"),
        (["safe", "--xyzzy"], "lab safe --xyzzy: is not an option; lab safe --help lists the options"),
        (["blind", "make", "set", "--sede", "5"], "lab blind make --sede: is not an option; did you mean --seed?"),
        (["blind", "score", "set", "--seed", "5"], "lab blind score --seed: is not an option; lab blind score --help"),
    ],
)
def test_an_unknown_option_is_answered_with_the_nearest(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    told = capsys.readouterr().err
    assert told.startswith(said) and len(told.splitlines()) == 1


@pytest.mark.parametrize("words", [["--", "--sped"], ["--help", "--sped"]])
def test_what_follows_two_dashes_or_asks_for_help_is_no_unknown_option(words: list[str]) -> None:
    assert declared("replay").unknown_option(["a.mcap", *words]) == ""


def test_the_table_and_the_modules_name_the_same_verbs() -> None:
    modules = {f"lab.{module}" for group in GROUPS.values() for module, _ in group.values()}
    declarations = [verb.name for module in modules for verb in import_module(module).VERBS]
    assert sorted(declarations) == sorted(VERBS)


@pytest.mark.parametrize("words", [["help"], ["recovr"]])
def test_the_list_of_verbs_needs_none_of_their_modules(words: list[str]) -> None:
    said = (
        "import sys; from lab.cli import main; main(sys.argv[1:]); "
        "print([m for m in sys.modules if m.startswith(('lab.verbs', 'numpy', 'pydantic', 'drivers'))])"
    )
    done = subprocess.run([sys.executable, "-c", said, *words], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("[]\n")


@pytest.mark.parametrize("verb", VERBS)
def test_the_help_of_a_verb_ends_with_examples_that_parse_and_a_page_that_exists(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["help", verb])
    told = capsys.readouterr().out
    assert "%%" not in told and " --reference A" not in told
    *_, first, second, empty, page = told.splitlines()
    assert not empty and (ROOT / page.removeprefix("page: ")).is_file()
    for line in (first, second):
        program, *words = shlex.split(line.partition(" > ")[0])
        assert program == "lab" and words[0] == verb
        if words[-1] == "--help":
            continue
        assert parser().parse_args(words).verb == verb


def test_files_have_names_in_the_usage(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["fit", "--help"])
    told = capsys.readouterr().out
    assert "--robot ROBOT.yaml" in told and "--out FOLDER" in told and "INPUT [INPUT ...]" in told
