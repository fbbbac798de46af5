"""Each finding has a code and one template, in the words for chambers and for tendons."""

import ast
import json
from dataclasses import asdict, replace
from pathlib import Path
from string import Formatter

from diagnosis.answer.result import Attribute, Data, Diagnosis, Locate
from diagnosis.findings import SEVERITY, TEMPLATES, finding
from model.actuators import Chambers, Tendons

ROOT = Path(__file__).parents[2]
WORDS = (Chambers.words, Tendons.words)
ANSWER = Diagnosis("No gap.", Data(1, 1, (), 0.1, ""), Locate(0.1, 0.1, False, {}, {}), Attribute("none", (), 1.0), None, ())


def codes(argument: ast.expr) -> set[str]:
    """Codes that the first argument of a call may be: a constant, or one of several by a condition."""
    if isinstance(argument, ast.IfExp):
        return codes(argument.body) | codes(argument.orelse)
    assert isinstance(argument, ast.Constant), ast.unparse(argument)
    return {str(argument.value)}


def calls() -> list[tuple[str, set[str]]]:
    """Code and names of the values of each finding that the product makes."""
    found = []
    for path in (p for room in ("diagnosis", "lab") for p in (ROOT / room).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or ast.unparse(node).startswith(("finding(code,", "mistake(code,")):
                continue
            of_edit = {"short", "p", "rather"}
            own = {"finding": set[str](), "stating": of_edit, "mistake": of_edit}.get(ast.unparse(node.func))
            if own is not None:
                found += [(code, {str(k.arg) for k in node.keywords} | own) for code in codes(node.args[0])]
    return found


def test_each_template_is_used_and_each_code_has_one() -> None:
    assert {code for code, _ in calls()} == set(SEVERITY)
    assert len(SEVERITY) == sum(map(len, TEMPLATES.values()))


def test_each_finding_has_the_values_that_its_template_states() -> None:
    own = set(vars(Chambers.words))
    for code, values in calls():
        template = TEMPLATES[SEVERITY[code]][code]
        assert {name for _, name, _, _ in Formatter().parse(template) if name} - own <= values, code
        assert "spine" not in template or code in ("one_spine_length", "one_stiffness_length"), "not every robot has one"


def test_one_template_speaks_of_chambers_and_of_tendons() -> None:
    of_chambers, of_tendons = (finding("one_pressure", words).text for words in WORDS)
    assert of_chambers.startswith("only one pressure") and "at least two pressures" in of_chambers
    assert of_tendons == of_chambers.replace("pressure", "tension").replace("chambers' area", "tendons' pull")


def test_values_from_outside_are_never_read_as_a_template() -> None:
    assert finding("not_considered", why="{pressures} {0}").text == "not considered: {pressures} {0}"


def test_the_file_of_an_answer_holds_code_severity_values_and_text() -> None:
    parts = [finding("number_moved", name="density", by=12.0, unit="%", side="above", sd=5.0, sd_unit="%")]
    answer = replace(ANSWER, findings=(finding("beyond_tolerance", fit="the fit", numbers=parts), finding("no_unload")))
    stored = json.loads(answer.to_json())
    first = stored["findings"][0]
    assert (first["code"], first["severity"]) == ("beyond_tolerance", "critical")
    assert first["values"] == {"fit": "the fit", "numbers": [asdict(parts[0])]}
    assert "density 12 % above robot.yaml (5 %)" in first["text"]
    assert stored["concerns"] == [f["text"] for f in stored["findings"]]
    assert Diagnosis.from_json(answer.to_json()).texts("warning") == [str(finding("no_unload"))]
