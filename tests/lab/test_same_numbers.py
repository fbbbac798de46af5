"""Headline, statement, page, command and diagnosis.json: the same number for the same word, over many answers."""

import html
import json
import re
from pathlib import Path

import numpy as np
import pytest
from diagnosed_case import Answered, campaign, folder

from diagnosis.answer.result import Diagnosis
from diagnosis.diagnose import diagnose
from lab.files.inputs import read_case
from lab.pages.diagnosis_report import write
from lab.verbs.diagnose import show
from model.effects import CATALOGUE

LENGTHS = ((0.0, 0.1, 0.2), (0.0, 0.2), (0.0, 0.15, 0.3))
PRESSURES = (0.0, 80e3, 160e3, 240e3)

Numbers = dict[str, str]


def drawn(seed: int) -> dict[str, float]:
    """Sizes of none, one or two effects of the catalogue, near their plausible scale."""
    rng = np.random.default_rng([11, seed])
    names = rng.choice(list(CATALOGUE), rng.choice([0, 1, 1, 1, 2]), replace=False)
    return {
        f"{name}.{p.name}": float(np.clip(p.scale * rng.uniform(0.5, 1.2), p.low, p.high))
        for name in names
        for p in CATALOGUE[name].parameters
        if p.role == "size"
    }


def answer(seed: int, place: Path) -> tuple[Diagnosis, Path]:
    """Of a campaign with these effects, and its page."""
    rows = campaign(drawn(seed), seed, 2 + seed % 2, LENGTHS[seed % len(LENGTHS)], PRESSURES)
    case = read_case([folder(place / "case", rows)])
    found = diagnose(case)
    return found, write(found, case, [place], place / "page.html")


def in_json(text: str) -> Numbers:
    """What every other surface has to say, from the file."""
    d = json.loads(text)
    which, fall, shrink = d["attribute"], d["waterfall"], d["shrink"]
    said = {"p": f"{which['probability']:.2f}", "noise floor": f"{d['locate']['noise_floor_mm']:.2f}"}
    if fall is not None:
        said["uncalibrated"] = f"{fall['given_mm']:.2f}"
        said["calibrated"] = f"{fall['steps'][0]['left_mm']:.2f}"
    if which["verdict"] == "effect" and shrink is not None:
        said["with cause"] = f"{shrink['after_mm']:.2f}"
        if (share := shrink["share_closed"]) is not None and share >= 0:
            said["closed"] = f"{100 * min(share, 1.0):.0f}"
    c, none = d["calibration"], d["attribute"]["verdict"] == "none" and d["fitted"] is None
    if c is not None and none and any(s["value"] > 2.5 * s["sd"] for s in c["set_up"]):
        said["set-up"] = "measure again"
    stiffness = c["modulus"] * (1.0 if c["determined"] else c["given"] / c["area_factor"]) if c is not None else 1.0
    if c is not None and max(abs(stiffness - 1), abs(c["modulus"] - 1)) >= 0.01:
        said |= {"area factor": f"{c['area_factor']:.2f}", "area factor given": f"{c['given']:.2f}"}
    if (robot := d["fitted"]) is not None:
        said["the robot of lab fit --with"] = f"{robot['left_mm']:.2f}"
        named = next(r["parameters"] for r in which["ranking"] if r["effects"] == which["effects"])
        assert {name: (v["value"], v["sd"]) for name, v in named.items()} == {
            name: (robot["parameters"][name]["value"], robot["parameters"][name]["sd"]) for name in named
        }
    for x in d["budget"]:
        if x["role"] != "unseen":
            name = d["detail"]["names"][x["effect"]]
            said |= dict.fromkeys((f"{x['effect']} moves", f"{name} moves"), f"{x['mm']:.2f}")
    for r in which["ranking"]:
        name = " + ".join(r["effects"]) or "none"
        said[f"p of {name}"] = probability(r["probability"])
        said[f"log evidence of {name}"] = "" if r["log_evidence"] is None else f"{r['log_evidence']:.1f}"
        if r["heldout_rmse_mm"] is not None:
            said[f"held out with {name}"] = f"{r['heldout_rmse_mm']:.2f}"
    return said


def probability(p: float) -> str:
    return "< 0.01" if p < 0.005 else f"{p:.2f}"


def found(patterns: dict[str, str], text: str) -> Numbers:
    """The first group that a pattern finds, by word."""
    every = {word: re.search(pattern, text) for word, pattern in patterns.items()}
    return {word: next(g for g in m.groups() if g) for word, m in every.items() if m}


def in_statement(text: str) -> Numbers:
    text = re.sub(r"Calibrated first: .*?\. (?=[A-Z])", "", text)  # which has probabilities of its own
    said = found(
        {
            "p": r"\(p (?:=|≤|is at most) ([\d.]+)",
            "uncalibrated": r"^.*[Uu]ncalibrated,? .*? misses the tip by ([\d.]+) mm rms",
            "calibrated": r" by ([\d.]+) mm on unseen states",
            "noise floor": r"the noise floor is ([\d.]+) mm",
            "set-up": r"the set-up fitted \([^)]+: (measure again)\)",
            "with cause": r"their tolerances, ([\d.]+) mm remain|states ([\d.]+) mm remain; |without it, ([\d.]+) mm with it",
            "closed": r"remain on unseen states: (\d+) % of the reducible gap",
            "area factor": r"\(([\d.]+) instead of",
            "area factor given": r"instead of ([\d.]+)[;,]",
        },
        text,
    )
    moved = re.search(r"After an area factor is refitted, (.*?\))\.", text)
    parts = moved[1].split("; ") if moved else []
    return said | {f"{name} moves": mm for p in parts for name, mm in re.findall(r"^(.+) moves the tip by ([\d.]+) mm", p)}


def in_page(text: str) -> Numbers:
    top = dict(re.findall(r"<dt>(?:<[^>]+>)*([^<]+)(?:</[^>]+>)*</dt><dd>([\d.]+) mm</dd>", text))
    lead = re.search(r'<p class="lead">([^<]*)</p>', text)
    assert lead is not None
    said = {**top, **found({"p": r"\(p [=≤] ([\d.]+)[,)]"}, lead[1])}
    plain = re.sub(r"<[^>]+>", "", text)
    said |= found({"closed": r"closed on unseen states with [^:]*: (\d+) %"}, plain) if "with cause" in top else {}
    for heading, rows in tables(text):
        if heading[0] == "step":
            left = {row[0].partition(" and the numbers")[0]: row[3] for row in rows}
            said["uncalibrated in steps"] = left["model, uncalibrated"]
            said["calibrated in steps"] = next(row for name, row in left.items() if name.startswith("calibration: one"))
        if heading[0] == "hypothesis":
            for row in rows:
                name = identifier(row[0])
                said |= {f"p of {name}": row[1].removeprefix("≤ ")} | ({f"log evidence of {name}": row[2]} if row[2] else {})
                said |= {f"held out with {name}": row[3]} if row[3] else {}
        if heading[0] == "effect" and "moves" in heading[1]:
            said |= {f"{identifier(row[0])} moves": row[1] for row in rows if "invisible" not in row[3]}
    return {word.removesuffix(" in steps"): number for word, number in said.items()}


def identifier(cell: str) -> str:
    """Effects of a cell, by their identifiers, as the command has them."""
    return " + ".join(re.findall(r"\[(\w+)\]", cell)) or {"no effect": "none"}.get(cell, "unknown")


def tables(text: str) -> list[tuple[list[str], list[list[str]]]]:
    """Headings and rows of every table of a page, as text."""
    cut = [re.findall(r"<tr>(.*?)</tr>", t, re.DOTALL) for t in re.findall(r"<table>(.*?)</table>", text, re.DOTALL)]
    cells = [[re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", r, re.DOTALL) for r in rows] for rows in cut]
    plain = [[[html.unescape(re.sub(r"<[^>]+>", "", c)).strip() for c in row] for row in rows] for rows in cells]
    return [(rows[0], rows[1:]) for rows in plain if rows and rows[0]]


def in_command(text: str) -> Numbers:
    said = in_statement(" ".join(text.split()))
    rows = [[c.strip() for c in line.split("│")[1:-1]] for line in text.splitlines() if line.startswith("│")]
    for row in rows:
        if len(row) == 5 and re.fullmatch(r"(≤ )?[\d.]+", row[1]):
            said |= {f"p of {row[0]}": row[1].removeprefix("≤ ")} | ({f"log evidence of {row[0]}": row[2]} if row[2] else {})
            said |= {f"held out with {row[0]}": row[3].removesuffix(" mm")} if row[3] else {}
    return said


@pytest.mark.parametrize("seed", [None, *(pytest.param(k, marks=pytest.mark.long) for k in range(50))])
def test_every_surface_says_the_same_number_for_the_same_word(
    seed: int | None, answered: Answered, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    d, page = (Diagnosis.from_json(answered.json.read_text()), answered.page) if seed is None else answer(seed, tmp_path)
    expected = in_json(d.to_json())
    assert {"p", "noise floor", "uncalibrated", "calibrated"} <= set(expected)
    monkeypatch.setattr("lab.console.out.width", 200)
    show(d)
    surfaces = {
        "headline": found({"p": r"\(p [=≤] ([\d.]+)[,)]"}, d.headline),
        "statement": in_statement(d.statement),
        "page": in_page(page.read_text()),
        "command": in_command(capsys.readouterr().out),
    }
    for name, said in surfaces.items():
        assert {word: (name, number) for word, number in said.items() if expected.get(word) != number} == {}
    top = {"p", "noise floor", "uncalibrated", "calibrated", *({"with cause", "closed"} & set(expected))}
    of_page = top - ({"p"} - surfaces["headline"].keys())  # which begins with the headline
    assert all((of_page if name == "page" else top) <= set(said) for name, said in surfaces.items() if name != "headline")
    assert all(any(w.startswith("p of ") for w in surfaces[name]) for name in ("page", "command"))
