"""What README and docs tell people to type works; what is not run here says why. Decisions that are referred to are there."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.diagnosis.small_campaigns import SOME
from tests.docs.blocks import ROOT, Block, anchors, blocks, pages
from tests.docs.workplace import Rigs, Workplace, needs
from tests.test_house import own_files

RUN = ("bash", "python")
FIRST = "docs/tutorials/first-day.md"
"""Its fakes have an effect, and serve the other pages too."""
KINDS = (*RUN, "yaml", "toml", "text", "{toctree}")
ALL = [block for page in pages() for block in blocks(page)]


def runs(page: Path) -> list[Block]:
    """The blocks of a page that are run here, and the files among them."""
    return [b for b in blocks(page) if not (b.not_run or b.run_by)]


def on_the_rig(page: Path) -> bool:
    return any("rig/rig.yaml" in b.text for b in runs(page) if b.kind in RUN)


RUNNABLE = sorted(
    {b.page for b in ALL if b.kind in RUN and not (b.not_run or b.run_by)},
    key=lambda p: (p != ROOT / FIRST, not on_the_rig(p), p),
)
"""Those that share a rig come first."""


@pytest.fixture(scope="session")
def rigs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rigs]:
    found = Rigs(tmp_path_factory.mktemp("rigs"))
    yield found
    found.sleep()


@pytest.mark.long
@pytest.mark.parametrize("page", RUNNABLE, ids=lambda p: str(p.relative_to(ROOT)))
def test_the_blocks_of_a_page_run_in_order(page: Path, rigs: Rigs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = Workplace(tmp_path / "page", rigs)
    monkeypatch.chdir(place.folder)
    # that a command can be typed is shown; what it finds among all effects, tests/lab/test_diagnose_verb.py shows
    if not any("plan finger/next" in b.text for b in runs(page)):  # few effects leave nothing to propose there
        monkeypatch.setattr("lab.files.own_effects.CATALOGUE", SOME)
    if on_the_rig(page):
        lines = [line for b in blocks(ROOT / FIRST) for line in b.text.splitlines()]
        place.line(next(line for line in lines if line.startswith("lab fakes --speed")))
    mine = runs(page)
    for number, block in enumerate(mine):
        if not any(needs(b.text) for b in mine[number:] if b.kind == "bash"):
            rigs.sleep()
        try:
            place.do(block)
        except BaseException as error:
            error.add_note(f"in the block of {block.where}")
            raise


def test_every_block_says_what_it_is() -> None:
    assert [b.where for b in ALL if b.kind not in KINDS] == []


def test_what_is_not_run_says_why() -> None:
    marked = [b for b in ALL if b.not_run or b.run_by]
    assert marked and all(b.kind in RUN for b in marked)
    assert [b.where for b in marked if b.not_run and len(b.not_run.split()) < 2] == []


@pytest.mark.parametrize("block", [b for b in ALL if b.run_by], ids=lambda b: b.where)
def test_the_test_that_stands_for_a_block_exists(block: Block) -> None:
    file, _, name = block.run_by.partition("::")
    text = (ROOT / file).read_text(encoding="utf-8")
    assert f"def {name}(" in text if name else "def test_" in text


@pytest.mark.parametrize("page", sorted({p for p in pages() if p.parent.name == "tutorials"}), ids=lambda p: p.stem)
def test_a_tutorial_runs_what_its_answer_proposes(page: Path) -> None:
    text = "\n".join(b.text.replace("\\\n", " ") for b in runs(page) if b.kind == "bash")
    for answer in re.findall(r"lab diagnose .*--report .*", text):
        (folder,) = re.findall(r"--protocols (\S+)", answer)
        assert f"lab run {folder}/" in text.partition(answer)[2]
    assert "--protocols" in page.read_text(encoding="utf-8")


def test_no_command_hides_outside_of_a_block() -> None:
    command = re.compile(r"^    +(lab|make|python|pip|from|import|\$) ")
    found = []
    for page in pages():
        inside = False
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
            inside ^= line.lstrip().startswith("```")
            if not inside and command.match(line):
                found.append(f"{page.relative_to(ROOT)}:{number}")
    assert found == []


def test_links_between_pages_lead_to_a_file_and_a_heading() -> None:
    found = []
    for page in pages():
        for target, place in re.findall(r"\]\(([^)#\s]*)(?:#([\w-]+))?\)", page.read_text(encoding="utf-8")):
            there = page.parent / target if target else page
            if "://" not in target and not (there.exists() and (not place or place in anchors(there))):
                found.append(f"{page.relative_to(ROOT)}: {target}#{place}")
    assert found == []


def test_pages_that_the_code_names_exist() -> None:
    named = re.compile(r"docs/[\w/-]+\.md")
    found = [
        f"{path.relative_to(ROOT)}: {name}"
        for room in ("lab", "drivers", "sim_fakes", "protocols", "recordings", "model", "diagnosis", "examples")
        for path in (ROOT / room).rglob("*.*")
        if path.suffix in (".py", ".yaml", ".toml")
        for name in named.findall(path.read_text(encoding="utf-8"))
        if not (ROOT / name).exists()
    ]
    assert found == []


# -- decisions: each that is referred to stands in docs/decisions.md, and is short
PAGE = ROOT / "docs/decisions.md"
MOST_WORDS = 60
"""Of the paragraph of one decision."""
HEADING = re.compile(r"^## (\d{3}) (.+)$", re.M)
REFERENCE = re.compile(r"\bdecisions?[\s#]+(\d{3}\b(?:(?:,|\s+and|,\s+and)[\s#]+\d{3}\b)*)", re.IGNORECASE)
"""One number or several, also across the end of a line or of a comment's line."""
ANCHOR = re.compile(r"decisions\.md#([\w-]*)")


def referred(text: str) -> list[str]:
    """The numbers of all decisions that a text refers to."""
    return [number for found in REFERENCE.findall(text) for number in re.findall(r"\d{3}", found)]


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("see decision 072.", ["072"]),
        ("(decisions 003, 010 and 012)", ["003", "010", "012"]),
        ("    # as decided (decision\n    # 034)", ["034"]),
        ("Decision 1000 and a decision of 300 words", []),
    ],
)
def test_references_are_found_however_they_are_written(text: str, numbers: list[str]) -> None:
    assert referred(text) == numbers


def test_every_decision_that_is_referred_to_exists() -> None:
    known = dict(HEADING.findall(PAGE.read_text(encoding="utf-8")))
    found = [f"{name}: decision {n}" for name, text in own_files(__file__).items() for n in referred(text) if n not in known]
    assert found == []


def test_every_link_to_a_decision_meets_its_heading() -> None:
    known = anchors(PAGE)
    found = [f"{name}#{a}" for name, text in own_files(__file__).items() for a in ANCHOR.findall(text) if a not in known]
    assert found == []


def test_decisions_are_in_order_and_short() -> None:
    _, *parts = HEADING.split(PAGE.read_text(encoding="utf-8"))
    numbers, paragraphs = parts[::3], parts[2::3]
    assert numbers == sorted(set(numbers))
    long = {n: len(p.split()) for n, p in zip(numbers, paragraphs, strict=True) if len(p.split()) > MOST_WORDS}
    assert long == {}
    assert [n for n, p in zip(numbers, paragraphs, strict=True) if "\n\n" in p.strip()] == []
