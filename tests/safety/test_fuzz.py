"""A few of the mutated files that `python -m benchmarks.faults.fuzz` makes by the thousand."""

import contextlib
import random
from pathlib import Path

import pytest

from benchmarks.faults.fuzz import EXPECTED, sources
from lab.files.config import ConfigError, read_yaml
from lab.files.inputs import read_case
from lab.files.resume import find
from recordings.errors import BadJournal, BadTable
from recordings.file.journal import read as read_journal
from recordings.file.writer import Recorder
from recordings.table_file import read_csv
from tests.simulated.bench import raises

RECORDING = Path(__file__).parent.parent / "recordings" / "data" / "bending-schema-1.mcap"


@pytest.mark.parametrize("seeds", [range(4), pytest.param(range(4, 15), marks=pytest.mark.long)])
def test_a_mutated_file_gives_a_result_or_a_clear_error(tmp_path: Path, seeds: range) -> None:
    kinds = sources(tmp_path, RECORDING)
    for name, go in kinds.items():
        for seed in seeds:
            with contextlib.suppress(*EXPECTED):
                go(random.Random(f"{name} {seed}"))()
    for seed in (7018, 7943, 9971):  # an attachment of impossible length
        with contextlib.suppress(*EXPECTED):
            kinds["recording"](random.Random(seed))()


def test_a_device_or_a_huge_file_is_not_read_as_configuration_table_or_journal(tmp_path: Path) -> None:
    raises(ConfigError, "not a file", read_yaml, Path("/dev/zero"))
    huge = tmp_path / "rig.yaml"
    with huge.open("wb") as file:
        file.truncate(2**33)
    raises(ConfigError, "more than", read_yaml, huge)
    for place, why in ((Path("/dev/zero"), "not a file"), (huge, "more than")):
        raises(BadTable, why, read_csv, place)
        raises(BadJournal, why, read_journal, place)


@pytest.mark.parametrize("name", ["../other.journal", "/etc/other.journal", "sub/other.journal"])
def test_a_journal_names_no_recording_elsewhere(tmp_path: Path, name: str) -> None:
    journal = tmp_path / "a.journal"
    journal.write_text(f'{{"journal": 1, "campaign": "c", "protocol": "bending"}}\n{{"recording": "{name}", "first_trial": 1}}\n')
    raises(ConfigError, "not a file in the same folder", find, journal)


def test_an_attached_robot_that_is_no_text_is_told(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=10**18, attachments={"robot.yaml": b"\xff\xfe\x00"}):
        pass
    raises(ConfigError, "robot.yaml is not a text file", read_case, [tmp_path / "a.mcap"])
