"""A few of the mutated files that `python -m benchmarks.faults.fuzz` makes by the thousand."""

from __future__ import annotations

import contextlib
import random
from pathlib import Path

import pytest

from benchmarks.faults.fuzz import EXPECTED, sources
from lab.config import ConfigError, read_yaml

RECORDING = Path(__file__).parent.parent / "recordings" / "data" / "bending-schema-1.mcap"
KINDS = sources(RECORDING)


@pytest.mark.parametrize("kind", range(len(KINDS)), ids=lambda i: f"{i}-{KINDS[i][0]}")
def test_a_mutated_file_gives_a_result_or_a_clear_error(kind: int) -> None:
    name, go = KINDS[kind]
    for seed in range(60):
        with contextlib.suppress(*EXPECTED):
            go(random.Random(f"{name} {seed}"))


@pytest.mark.parametrize("seed", [7018, 7943, 9971])
def test_an_attachment_of_impossible_length_is_damage(seed: int) -> None:
    name, go = KINDS[seed % len(KINDS)]
    assert name == "recording"
    with contextlib.suppress(*EXPECTED):
        go(random.Random(seed))


def test_a_device_or_a_huge_file_is_not_read_as_configuration(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="not a file"):
        read_yaml(Path("/dev/zero"))
    huge = tmp_path / "rig.yaml"
    with huge.open("wb") as file:
        file.truncate(2**33)
    with pytest.raises(ConfigError, match="bytes"):
        read_yaml(huge)
