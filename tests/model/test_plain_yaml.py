"""YAML of people: plain values only, and one error with its line for everything else."""

import pytest

from model.plain_yaml import MOST_CHARACTERS, MOST_VALUES, BadYaml, parse
from tests.simulated.bench import raises


def test_tables_lists_numbers_and_texts_are_read() -> None:
    text = "a: [1, -2.5, 1.0e-3, ox10, a_1]\nb: {c: yes, d: ~, 0.05: 250 kPa}\n# note\ne: '007'\n"
    values = {"a": [1, -2.5, 1e-3, "ox10", "a_1"], "b": {"c": True, "d": None, 0.05: "250 kPa"}, "e": "007"}
    assert parse(text)[0] == values
    assert parse("")[0] is None


@pytest.mark.parametrize(
    ("value", "word"),
    [
        ("!!timestamp foo", "tag"),
        ("!!int ''", "tag"),
        ("!!float x", "tag"),
        ("!!binary aGk=", "tag"),
        ("!!set {a, b}", "tag"),
        ("!!python/object/apply:os.system [id]", "tag"),
        ("*other", "alias"),
        ("0x" + "f" * 400, "number"),
        ("9" * 5000, "number"),
        ("0b_", "number"),
        ("010", "number"),
        ("1_000", "number"),
        ("0.0_5", "number"),
        ("0x10", "number"),
        ("1:30", "number"),
        ("1.0e+999", "too large"),
        ("9007199254740993", "exceeds"),
        ('"\\0"', "character"),
        ('"\\ud800"', "character"),
        ("[" * 30 + "]" * 30, "levels of nested"),
        ("{a: 1, a: 2}", "twice"),
        ("{[1]: 2}", "cannot be a key"),
        ("@", "not valid YAML"),
    ],
)
def test_everything_else_is_an_error_with_its_line(value: str, word: str) -> None:
    with pytest.raises(BadYaml, match=word) as caught:
        parse(f"x: 1\ny: {value}\n")
    assert caught.value.line == 2 and len(str(caught.value)) < 200


@pytest.mark.parametrize("text", ["\0", "a: \0", "\ud800", "%YAML 9.9\n---\na", "--- a\n--- b", "]", "\t"])
def test_what_is_no_yaml_at_all_is_an_error(text: str) -> None:
    raises(BadYaml, "not valid YAML", parse, text)


def test_a_key_is_a_name_whatever_yaml_makes_of_it_elsewhere() -> None:
    assert parse("{on: 1, off: 2, No: 3, ~: 4, y: 5, 0.1: 6}")[0] == {"on": 1, "off": 2, "No": 3, "~": 4, "y": 5, 0.1: 6}


def test_a_date_is_a_text_and_a_merge_key_is_a_key_like_any_other() -> None:
    assert parse("a: 2001-01-01\n")[0] == {"a": "2001-01-01"}
    assert parse("<<: {a: 1}\n")[0] == {"<<": {"a": 1}}


@pytest.mark.parametrize(
    "text", ["x" * (MOST_CHARACTERS + 1), "[" + "1," * MOST_VALUES + "]", "[" * 500, "- " * 500, "{a: " * 500]
)
def test_what_is_longer_or_deeper_than_any_sensible_file_is_given_up_early(text: str) -> None:
    raises(BadYaml, "more than", parse, text)
