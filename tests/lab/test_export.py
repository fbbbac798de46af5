"""`lab export --mat`, `--crate` and `--arviz`: what other programs read, tried with their own readers."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosed_case import answered_once, campaign, folder
from scipy.io import loadmat

from lab.cli import main
from lab.files.crate import write_crate
from recordings.campaign.info import info
from recordings.table_file import read_csv
from recordings.trials import Table

RECORDING = Path(__file__).parent.parent / "recordings" / "data" / "bending-schema-1.mcap"


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = folder(tmp_path_factory.mktemp("case") / "case", campaign({}, repeats=1, lengths=(0.0, 0.2)))
    (made / "diagnosis.json").write_text(json.dumps({"schema": "diagnosis/1", "statement": "Cause: none."}))
    return made


def test_a_crate_describes_all_that_is_in_it(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from rocrate.rocrate import ROCrate  # slow to import

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


def test_who_ran_it_is_the_agent_of_the_recording(tmp_path: Path) -> None:
    from rocrate.rocrate import ROCrate

    (tmp_path / "robot.yaml").write_text("name: finger\n")
    found = info(RECORDING)
    ran = {name: replace(found, metadata={"labels": {"operator": "Lin Ø."}}) for name in ("a.mcap", "b.mcap")}
    write_crate(tmp_path / "crate", [tmp_path / "robot.yaml"], Table(()), {**ran, "c.mcap": found}, "runs", None)
    crate = ROCrate(tmp_path / "crate")
    agents = [crate.get(f"#recorded-{letter}.mcap").get("agent") for letter in "abc"]
    assert [agent and (agent.type, agent["name"]) for agent in agents] == [("Person", "Lin Ø.")] * 2 + [None]
    assert len([e for e in crate.get_entities() if e.type == "Person"]) == 1


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


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = answered_once(tmp_path_factory.getbasetemp() / "diagnosis")
    case = tmp_path_factory.mktemp("arviz") / "spine"
    shutil.copytree(made.case, case)
    shutil.copy(made.json, case / "diagnosis.json")
    return case


def test_arviz_opens_what_a_diagnosis_states(diagnosed: Path, tmp_path: Path) -> None:
    assert main(["export", str(diagnosed), "--arviz", "--out", str(tmp_path / "a")]) == 0
    assert main(["export", str(diagnosed), "--arviz", "--out", str(tmp_path / "b")]) == 0
    import arviz  # writes a file of its own when imported, which two processes at once cannot

    opened, again = (arviz.from_netcdf(tmp_path / place / "spine.nc") for place in "ab")
    said = json.loads((diagnosed / "diagnosis.json").read_text())
    leading = next(r for r in said["attribute"]["ranking"] if r["parameters"])
    posterior, evidence = opened.posterior, opened.evidence
    assert set(posterior.data_vars) == set(leading["parameters"]) and posterior.sizes == {"chain": 4, "draw": 1000}
    assert posterior.attrs["hypothesis"] == " + ".join(leading["effects"])
    assert (
        posterior.attrs["robot"]
        and posterior.attrs["inference_library_version"]
        and "no covariance" in posterior.attrs["drawn_from"]
    )
    for size in said["detail"]["sizes"]:
        draws = posterior[size["name"]]
        assert draws.attrs["units"] == size["unit"] and float(draws.min()) >= size["low"] and float(draws.max()) <= size["high"]
        for quantile, stated in ((0.05, size["low90"]), (0.95, size["high90"])):
            assert float(draws.quantile(quantile)) == pytest.approx(stated, abs=0.1 * size["sd"])
        assert np.array_equal(draws, again.posterior[size["name"]])
    assert arviz.summary(opened, var_names=list(leading["parameters"])).shape[0] == len(leading["parameters"])
    for r in said["attribute"]["ranking"]:
        row = evidence.sel(hypothesis=" + ".join(r["effects"]) or "none")
        assert (float(row.probability), float(row.log_evidence)) == (r["probability"], r["log_evidence"])
        assert {str(e) for e in evidence.effect.values if row.named.sel(effect=e) == 1} == set(r["effects"])
        stated = {
            str(n): float(row.value.sel(parameter=n)) for n in evidence.parameter.values if np.isfinite(row.sd.sel(parameter=n))
        }
        assert stated == {n: v["value"] for n, v in r["parameters"].items()}
    assert float(evidence.probability.sum()) <= 1 + 1e-9


@pytest.mark.parametrize("lacking", ["xarray", "h5netcdf"])
def test_arviz_without_its_library_says_what_to_install(
    lacking: str, diagnosed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, lacking, None)
    assert main(["export", str(diagnosed), "--arviz", "--out", str(tmp_path)]) == 2
    assert "pip install 'softlab[arviz]'" in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_what_was_not_diagnosed_has_no_probabilities(case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(RECORDING), "--arviz", "--out", str(tmp_path)]) == 2
    assert "--arviz takes case folders that were diagnosed" in " ".join(capsys.readouterr().err.split())
    assert main(["export", str(case), "--arviz", "--out", str(tmp_path)]) == 2
    assert "not a diagnosis/1 file" in " ".join(capsys.readouterr().err.split())
    bare = tmp_path / "bare"
    bare.mkdir()
    assert main(["export", str(bare), "--arviz", "--out", str(tmp_path)]) == 2
    assert "first: lab diagnose" in " ".join(capsys.readouterr().err.split())
