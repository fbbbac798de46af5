"""The rules of the house hold: who may import whom, and who may know of fakes."""

import ast
import functools
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parent.parent
ROOMS = ("lab", "drivers", "sim_fakes", "protocols", "recordings", "model", "diagnosis")


def own_files(me: str) -> dict[str, str]:
    """The text of each of the project's own files, by name, but that of the test which reads them."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
    if not listed:
        pytest.skip("not a git checkout: there is no list of the project's own files")
    names = [n for n in listed if Path(n).name != Path(me).name and not n.endswith((".png", ".mcap")) and (ROOT / n).is_file()]
    return {name: (ROOT / name).read_text(encoding="utf-8", errors="replace") for name in names}


def lines_with(pattern: str, files: Iterable[Path], flags: int = 0) -> list[str]:
    """Place and text of each line in which a pattern is found."""
    lines = ((path, *own) for path in files for own in enumerate(path.read_text(encoding="utf-8").splitlines(), 1))
    return [f"{path.relative_to(ROOT)}:{number}: {line}" for path, number, line in lines if re.search(pattern, line, flags)]


def test_import_contracts_hold() -> None:
    done = subprocess.run([Path(sys.executable).parent / "lint-imports"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_the_clock_stands_on_nothing() -> None:
    tree = ast.parse((ROOT / "timing.py").read_text())
    named = [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    named += [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    assert not {n.split(".")[0] for n in named} & set(ROOMS)


def test_no_folder_holds_more_than_a_person_can_keep_in_the_head_and_each_says_what_lives_there() -> None:
    for room in (*ROOMS, "benchmarks"):
        for folder in [ROOT / room, *(p for p in (ROOT / room).rglob("*/") if p.name != "__pycache__")]:
            modules = [p for p in folder.glob("*.py") if p.name != "__init__.py"]
            assert len(modules) <= 20, folder
            assert not modules or ast.get_docstring(ast.parse((folder / "__init__.py").read_text())), folder


MOST_LINES = {
    "lab": 25_901, "drivers": 7_237, "model": 12_402, "protocols": 2_738, "recordings": 7_389, "diagnosis": 13_469,
    "sim_fakes": 7_421, "product": 76_849, "tests": 36_859, "benchmarks": 9_958,
}  # fmt: skip
"""Lines of Python of each room, of the product as a whole (its rooms and timing.py), of its tests and of the research on it: what
a person has to scroll through. A change may lower a number; it raises none."""


def test_no_room_grows() -> None:
    files = {room: [*(ROOT / room).rglob("*.py")] for room in (*ROOMS, "tests", "benchmarks")}
    files["product"] = [ROOT / "timing.py", *(path for room in ROOMS for path in files[room])]
    lines = {room: sum(len(path.read_text(encoding="utf-8").splitlines()) for path in own) for room, own in files.items()}
    grown = [f"{room} has {lines[room]:,} lines, {lines[room] - most:,} more than {most:,}" for room, most in MOST_LINES.items()
             if lines[room] > most]  # fmt: skip
    assert grown == [], "a room is full: delete, merge or use a library, and never squeeze code"


def test_no_two_files_of_tests_have_one_name() -> None:
    names = [p.name for p in (ROOT / "tests").rglob("*.py") if p.name not in ("conftest.py", "__init__.py")]
    assert sorted(names) == sorted(set(names))


def test_no_modules_import_each_other_in_a_circle() -> None:
    graph = grimp.build_graph(*ROOMS, cache_dir=None)
    TopologicalSorter({m: graph.find_modules_directly_imported_by(m) for m in graph.modules}).prepare()


@pytest.mark.parametrize("room", [r for r in ROOMS if r not in ("sim_fakes", "lab")])
def test_no_room_but_its_own_speaks_of_fakes(room: str) -> None:
    assert lines_with(r"\b(sim_fakes|fakes?|simulated?|is_sim|mock)\b", (ROOT / room).rglob("*.py"), re.IGNORECASE) == []


def test_in_lab_only_the_modules_that_start_them_import_the_fakes() -> None:
    users = {p.stem for p in (ROOT / "lab").rglob("*.py") if re.search(r"^\s*(from|import) sim_fakes", p.read_text(), re.M)}
    assert users == {"fakes", "demo", "driver_contract"}


def test_no_file_names_a_machine_path_or_a_package_index() -> None:
    bad = re.compile(r"/(?:work|root|home)/|https?://[^/\s]*(pypi|npmjs|artifactory|index)[^\s]*", re.IGNORECASE)
    assert [(name, found.group()) for name, text in own_files(__file__).items() if (found := bad.search(text))] == []


PAGES = sorted({ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")} | set((ROOT / "docs").rglob("*.md")))
MOST_WORDS = 36_000
"""Of all pages together."""


def test_no_line_of_markdown_is_wider_than_120_characters() -> None:
    assert lines_with(r".{121}", PAGES) == []


def test_the_documentation_stays_short() -> None:
    words = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").split()) for path in PAGES}
    longest = sorted(words.items(), key=lambda item: -item[1])[:8]
    assert sum(words.values()) <= MOST_WORDS, f"link to what another page says; the longest pages: {longest}"


LAB = sorted((ROOT / "lab").rglob("*.py"))
CONSOLE = ROOT / "lab" / "console.py"
nodes = functools.cache(lambda path: list(ast.walk(ast.parse(path.read_text()))))
"""Of a file."""
TAG = re.compile(r"\[/[a-z ]*\]|\[(bold|dim|italic|underline|red|green|yellow|blue|cyan|magenta|white)\b[a-z ]*\]")


def calls(path: Path, name: str) -> list[ast.Call]:
    """The calls of a function by its bare name."""
    return [n for n in nodes(path) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name) and n.func.id == name]


def test_text_reaches_the_screen_through_the_plain_console_alone() -> None:
    parts = re.compile(r"^\s*(from rich(\.(console|text|markup|progress|live|panel|logging))? import|import rich)", re.M)
    assert [str(p) for p in LAB if p != CONSOLE and parts.search(p.read_text())] == []
    assert [str(p) for p in LAB if calls(p, "Text") and p != CONSOLE] == []


THEIR_OWN_TIME = (
    "timing.py", "tests/simulated/clock.py", "recordings/", "lab/live/", "lab/console.py", "lab/verbs/",
    "tests/sim_fakes/test_simulated_clock.py", "tests/recordings/", "tests/docs/", "tests/test_house.py",
)  # fmt: skip
"""What waits for files, browsers and persons, or says how long something took: the computer's own time."""


def test_all_else_waits_on_the_one_clock() -> None:
    """So that it can jump over the time in which everything waits, see `timing`."""
    waits = r"\btime\.(sleep|monotonic)\b|\bthreading\.(Event|R?Lock|Condition|Thread|Timer)\(|\bselect\.select\("
    files = [p for room in (*ROOMS, "tests") for p in (ROOT / room).rglob("*.py")]
    assert lines_with(waits, (p for p in files if not str(p.relative_to(ROOT)).startswith(THEIR_OWN_TIME))) == []


@pytest.mark.parametrize("room", [r for r in ROOMS if r not in ("sim_fakes", "lab")])
def test_no_room_but_the_lab_prints(room: str) -> None:
    users = [str(p) for p in (ROOT / room).rglob("*.py") if calls(p, "print") or "import rich" in p.read_text()]
    assert users == []


def test_what_is_printed_beside_it_is_json_which_no_verb_prints_by_itself() -> None:
    of_results = [CONSOLE, ROOT / "lab" / "live" / "expected.py"]
    odd = [
        f"{path.relative_to(ROOT)}:{call.lineno}"
        for path in LAB
        for call in calls(path, "print")
        if not ast.unparse(call.args[:1]).startswith("json.dumps(" if path in of_results else "message.to_json(")
    ]
    assert odd == []


def test_no_text_of_the_lab_is_markup() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.value!r}"
        for path in LAB
        for node in nodes(path)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and TAG.search(node.value)
    ]
    assert found == []


def test_pages_escape_everything() -> None:
    environments = [call for path in LAB for call in calls(path, "Environment")]
    assert environments
    for call in environments:
        (escaping,) = [k.value for k in call.keywords if k.arg == "autoescape"]
        assert isinstance(escaping, ast.Constant) and escaping.value is True
    for page in (ROOT / "lab").rglob("*.j2"):
        text = page.read_text()
        assert not re.search(r"\|\s*safe|autoescape|<script", text), page
        assert not any("{{" in style or "{%" in style for style in re.findall(r"<style.*?</style>", text, re.S)), page


def test_the_wheel_holds_whatever_the_rooms_hold_and_nothing_else() -> None:
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    assert build["packages"]["find"]["include"] == [f"{room}*" for room in ROOMS]
    patterns = ("*.py", *build["package-data"]["*"])
    files = [path for room in ROOMS for path in (ROOT / room).rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    left_out = [str(p) for p in files if not any(p.match(pattern) for pattern in patterns)]
    assert left_out == []
    away = [str(p) for p in files if p.suffix == ".py" and re.search(r"/ \"(examples|tests|docs)\b", p.read_text())]
    assert away == []


def test_processes_of_our_own_find_no_modules_in_the_folder_where_a_person_stands() -> None:
    """A folder named like a package, there, would take the package's place."""
    started = [(path, text) for room in ROOMS for path in (ROOT / room).rglob("*.py") if (text := path.read_text())]
    unsafe = [path for path, text in started if re.search(r'sys\.executable,\s*"-m"', text)]
    assert not unsafe
