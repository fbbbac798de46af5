"""The headline: at most 20 plain words, the size in a person's unit, and the same conclusion as the statement."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from diagnosis.answer.headline import headline
from diagnosis.answer.result import Attribute, Conclusion, Ranked, Value, Verdict
from diagnosis.criticism.stage_errors import StageError
from model.effects.catalogue import CATALOGUE


def attribute(
    verdict: Verdict, conclusion: Conclusion, sizes: dict[str, Value] | None = None, *effects: str, p: float = 0.96
) -> Attribute:
    ranking = (Ranked(effects, p, 10.0, None, sizes or {}),)
    return Attribute(verdict, effects, p, (), ranking, (), conclusion=conclusion)


@pytest.mark.parametrize(
    ("effect", "sizes", "words"),
    [
        (
            "chamber_azimuth",
            {"angle": (0.1396, "rad")},
            "The chambers are turned by 8.0 ± 0.6 deg about the axis (p = 0.96).",
        ),
        ("spine_length_offset", {"offset": (-0.0123, "m")}, "The spine is 12 ± 10 mm shorter than read (p = 0.96)."),
        ("body_modulus", {"excess": (0.15, "1")}, "The body's silicone is 15 ± 1 % stiffer than stated (p = 0.96)."),
        ("base_tilt", {"x": (0.03, "rad"), "y": (-0.04, "rad")}, "The base is tilted by 2.9 ± 0.6 deg (p = 0.96)."),
        ("pressure_deadband", {"band": (9e3, "Pa")}, "The chambers act only above 9.0 kPa (p = 0.96)."),
        ("chamber_order", {}, "The chambers hang on other regulators than robot.yaml states (p = 0.96)."),
        ("my_own_effect", {"d": (3.0, "1")}, "My own effect is at work (p = 0.96)."),
    ],
)
def test_a_cause_is_said_with_its_size(effect: str, sizes: dict[str, tuple[float, str]], words: str) -> None:
    found = {f"{effect}.{name}": Value(value, 0.01, unit) for name, (value, unit) in sizes.items()}
    assert headline(attribute("effect", "cause", found, effect), CATALOGUE) == words


def test_a_size_that_the_data_do_not_determine_is_not_stated() -> None:
    sizes = {"spine_length_offset.offset": Value(-0.0123, 0.01, "m", determined=False)}
    said = headline(attribute("effect", "cause", sizes, "spine_length_offset"), CATALOGUE)
    assert said == "The spine is some amount longer or shorter than read (p = 0.96)."


@pytest.mark.parametrize("effect", CATALOGUE)
@pytest.mark.parametrize("sign", [1, -1])
def test_every_effect_of_the_catalogue_fits_and_needs_no_identifier(effect: str, sign: int) -> None:
    sizes = {f"{effect}.{p.name}": Value(sign * 0.123456 * p.scale, 0.0, p.unit) for p in CATALOGUE[effect].parameters}
    for conclusion in ("cause", "one of several"):
        said = headline(attribute("effect", conclusion, sizes, effect), CATALOGUE)  # type: ignore[arg-type]
        assert len(said.split()) <= 20 and "_" not in said and not set(said) & set("[]{}|")
        assert said.startswith("Most likely ") == (conclusion == "one of several")


def test_two_causes_and_the_other_conclusions_fit_too() -> None:
    two = headline(attribute("effect", "one of several", {}, "tendon_friction", "chamber_gain"), CATALOGUE)
    assert len(two.split()) <= 20 and two.endswith("and 1 more (p = 0.96).")
    vain = headline(attribute("effect", "one of several", {}, "tether", p=0.77), CATALOGUE, closed=0.0)
    assert vain.startswith("Unclear: nothing closes the gap; nearest is") and vain.endswith("(p = 0.77).")
    asking = (StageError("material", "spine_length", 20.0),)
    unknown = headline(replace(attribute("unknown", "stage", p=0.6), stage_errors=asking), CATALOGUE)
    assert unknown == ("No known cause fits (p = 0.60); it may be in the material and varies with spine length.")
    none = headline(attribute("none", "noise", p=0.9), CATALOGUE, by_calibration=0.93)
    assert none == "Calibration closes 93 % of the gap; no other cause is needed (p = 0.90)."
    unsure = headline(attribute("none", "noise", p=0.42), CATALOGUE, by_calibration=0.93)
    assert unsure == "Calibration closes 93 % of the gap; no other cause stands out (p = 0.42)."
    lacks = ("no repeated pushes to two deflections at two lengths",)
    made = [
        headline(attribute("none", "none"), CATALOGUE),
        headline(attribute("none", "noise"), CATALOGUE),
        headline(attribute("unknown", "too little data"), CATALOGUE, missing=lacks),
    ]
    assert all(len(said.split()) <= 20 for said in (unknown, none, *made)) and lacks[0] in made[-1]


def tied(effect: str, sizes: dict[str, Value], p: float, other: str, q: float, found: dict[str, Value]) -> str:
    a = attribute("effect", "one of several", sizes, effect, p=p)
    second = Ranked((other,) if other else (), q, 9.0, None, found)
    return headline(replace(a, ranking=(*a.ranking, second)), CATALOGUE)


def test_two_that_are_nearly_as_probable_are_both_named() -> None:
    tilt, turn = (
        {f"{effect}.x": Value(angle, 0.01, "rad"), f"{effect}.y": Value(0.0, 0.01, "rad")}
        for effect, angle in (("base_tilt", 0.0628), ("frame_misalignment", 0.0611))
    )
    both = tied("base_tilt", tilt, 0.49, "frame_misalignment", 0.47, turn)
    assert both == "The base is tilted by 3.6 deg or the cameras' frame is turned by 3.5 deg (p = 0.49, 0.47)."
    assert "frame" not in tied("base_tilt", tilt, 0.55, "frame_misalignment", 0.41, turn)
    assert tied("base_tilt", tilt, 0.49, "", 0.45, {}).endswith("or there is no cause (p = 0.49, 0.45).")


def test_both_fit_whichever_they_are() -> None:
    for effect, other in itertools.permutations(CATALOGUE, 2):
        sizes, found = (
            {f"{e}.{p.name}": Value(0.123456 * p.scale, 0.0, p.unit) for p in CATALOGUE[e].parameters} for e in (effect, other)
        )
        said = tied(effect, sizes, 0.49, other, 0.47, found)
        assert len(said.split()) <= 20 and said.endswith("(p = 0.49, 0.47)."), said
