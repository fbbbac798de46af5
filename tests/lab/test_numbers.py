"""Numbers of protocol files and `--set` that are none, or lead nowhere: one clear error before anything is connected."""

from __future__ import annotations

from pathlib import Path

import pytest

from lab.cli import main

RIG = Path(__file__).parents[2] / "examples" / "rig" / "rig.yaml"


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("rate=1e-320", "rate = 9.99989e-321 Pa/s: must be 0, or at least"),
        ("rate='1e-320 kPa/s'", "must be 0, or at least"),
        ("rate=1e-300", "days of rig time, at most 30"),
        ("rate=1e-3", "days of rig time, at most 30"),
        ("rate=1e400", "must be a finite number"),
        ("rate=.nan", "must be a finite number"),
        ("rate=true", "rate = true: must be a number in Pa/s"),
        ("repeats=true", "repeats = true: must be a number"),
        ("chambers=[true]", "chambers[0] = true: must be a number"),
        ("repeats=1e300", "repeats"),
        ("repeats=three", "repeats = 'three': must be a number"),
        ("settle.band=1e-320", "settle.band = 9.99989e-321 Pa: must be 0, or at least"),
        ("spine_lengths=[1e-320]", "spine_lengths[0]"),
    ],
)
def test_a_number_that_is_none_is_named(setting: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "bending", "--rig", str(RIG), "--set", setting]) == 2
    assert words in " ".join(capsys.readouterr().err.split())


def test_a_number_that_yaml_takes_for_a_text_is_one() -> None:
    assert main(["plan", "bending", "--rig", str(RIG), "--set", "repeats=1e0", "--set", "rate=2e4"]) == 0
