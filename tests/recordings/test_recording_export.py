"""Export: every number of every stream, as CSV, and the case folder."""

import csv
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from synthetic_run import Run, recorded

from recordings.campaign.export import export_case, export_streams
from recordings.errors import BadTable
from recordings.file.reader import Recording
from recordings.file.writer import Recorder
from recordings.messages import sensor
from recordings.trials import TrialRow

COLUMNS = {
    "pressure": ["t", *(f"{n}_{i}" for n in ("setpoint", "measured") for i in range(1, 10))],
    "vacuum": ["t", "absolute"],
    "force": ["t", *(f"{n}_{i}" for n in ("raw", "zero") for i in range(1, 7))],
}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return Recording.open(recorded(tmp_path_factory.mktemp("export") / "run.mcap", Run(duration=2.0)))


def test_every_number_of_every_stream_is_there_to_the_last_bit(recording: Recording, tmp_path: Path) -> None:
    files = {f.stem: f for f in export_streams(recording, tmp_path / "new")}
    assert files.pop("columns").suffix == ".csv" and {f.suffix for f in files.values()} == {".csv"}
    assert set(files) == {"pressure", "tip", "spine", "vacuum", "force", "arm"}  # the valve sent nothing
    for name, columns in COLUMNS.items():
        found, samples = pd.read_csv(files[name]), recording.stream(f"/{name}")
        assert list(found) == columns
        expected = np.column_stack([samples[n].reshape(len(samples), -1) for n in samples.dtype.names or ()])
        assert np.array_equal(found.to_numpy(), expected)


def test_a_recording_without_a_concluded_state_makes_no_case_folder(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(BadTable, match="lab replay"):
        export_case(recording, tmp_path / "case")
    assert not (tmp_path / "case").exists()


def test_every_column_is_described_with_unit_and_time_base(recording: Recording, tmp_path: Path) -> None:
    files = {f.stem: f for f in export_streams(recording, tmp_path)}
    rows = {(row["file"], row["column"]): row for row in csv.DictReader(files["columns"].read_text().splitlines())}
    for name, path in files.items():
        if name != "columns":
            assert [column for of, column in rows if of == name] == path.read_text().splitlines()[0].split(",")
    assert rows["pressure", "measured_2"]["unit"] == "Pa" and rows["pressure", "measured_2"]["meaning"].startswith("chamber 2;")
    assert [rows["tip", f"orientation_{i}"]["meaning"].partition(";")[0] for i in range(1, 5)] == ["w", "x", "y", "z"]
    assert [rows["tip", f"markers_{i}"]["meaning"].partition(";")[0] for i in (1, 6)] == ["x of number 1", "z of number 2"]
    assert (rows["force", "raw_3"]["unit"], rows["force", "raw_4"]["unit"]) == ("N", "N m")
    assert [key for key, row in rows.items() if not row["meaning"]] == []
    assert re.search(r"t = 0 at \d{4}-\d\d-\d\dT.*[+]00:00", rows["tip", "t"]["meaning"])


def test_a_sensor_s_column_says_what_its_driver_declares(tmp_path: Path) -> None:
    palm = sensor("palm", {"grip": "N"})
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18, sensors=[palm]) as recorder:
        recorder.push(palm.topic, 0.5, grip=2.0)
        recorder.trial(1.0, 1, TrialRow(1, 1, "squeeze", 1, "load", 1.0, 0.0, (0.0,) * 9, sensors={"sensor_palm_grip": 2.0}))
    written = export_streams(Recording.open(tmp_path / "run.mcap"), tmp_path)
    rows = {row["column"]: row for row in csv.DictReader(written[-1].read_text().splitlines())}
    assert (rows["grip"]["unit"], rows["grip"]["meaning"]) == ("N", "grip measured by the sensor palm")
    assert rows["sensor_palm_grip"]["meaning"] == "palm_grip: sensor and quantity, averaged"
