"""`lab export --mat` and `--crate`: what other programs read, tried with their own readers."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
from diagnosed_case import campaign, folder
from rocrate.rocrate import ROCrate
from scipy.io import loadmat

from lab.cli import main
from recordings.table_file import read_csv

RECORDING = Path(__file__).parent.parent / "recordings" / "data" / "bending-schema-1.mcap"


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = folder(tmp_path_factory.mktemp("case") / "case", campaign({}, repeats=1, lengths=(0.0, 0.2)))
    (made / "diagnosis.json").write_text(json.dumps({"schema": "diagnosis/1", "statement": "Cause: none."}))
    return made


def test_a_crate_describes_all_that_is_in_it(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "supplement"
    assert main(["export", str(case), str(RECORDING), "--crate", "--out", str(out), "--name", "Gap of a robot"]) == 0
    assert "no licence is stated" in capsys.readouterr().err
    crate = ROCrate(out)
    assert crate.name == "Gap of a robot"
    files = {e.id: e for e in crate.data_entities}
    assert set(files) == {"robot.yaml", "trials.csv", "diagnosis.json", RECORDING.name}
    assert set(files) | {"ro-crate-metadata.json"} == {p.name for p in out.iterdir()}
    for name, entity in files.items():
        assert entity["sha256"] == hashlib.sha256((out / name).read_bytes()).hexdigest()
    assert files["diagnosis.json"]["abstract"] == "Cause: none."
    units = {c["name"]: c["unitText"] for c in files["trials.csv"]["variableMeasured"]}
    assert set(units) == set(read_csv(case / "trials.csv").columns) and (units["p1"], units["z"], units["trial"]) == (
        "Pa",
        "m",
        "1",
    )
    assert crate.get("#robot")["additionalProperty"][0]["name"] == "length"
    recorded = crate.get(f"#recorded-{RECORDING.name}")
    assert recorded["result"].id == RECORDING.name and recorded["startTime"]
    assert crate.get("#analysed")["instrument"]["softwareVersion"]


def test_a_case_as_a_matlab_file(case: Path, tmp_path: Path) -> None:
    assert main(["export", str(case), "--mat", "--out", str(tmp_path)]) == 0
    trials = loadmat(tmp_path / "case.mat", squeeze_me=True, struct_as_record=False)["trials"]
    table = read_csv(case / "trials.csv")
    assert trials._fieldnames == list(table.columns) and (trials.z == table["z"]).all()


@pytest.mark.parametrize(
    ("options", "words"),
    [(["--case"], "is a case already"), (["--parquet"], "has no streams"), ([], "has no streams")],
)
def test_a_case_has_no_streams(
    case: Path, tmp_path: Path, options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(case), "--out", str(tmp_path), *options]) == 2
    assert words in capsys.readouterr().err
    assert main(["export", str(case / "robot.yaml"), "--crate", "--out", str(tmp_path)]) == 2
    assert "give recordings" in capsys.readouterr().err
