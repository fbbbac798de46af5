"""`lab export --crate`: what other programs read; and no folder of results is written through a link."""

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from commands import Cli

from lab.verbs.export import write_crate
from recordings.campaign.info import info
from recordings.table_file import read_csv
from recordings.trials import Table

RECORDING = Path(__file__).parents[1] / "recordings/data/bending-schema-1.mcap"


@pytest.fixture(scope="module")
def case(small_case: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = Path(shutil.copytree(small_case, tmp_path_factory.mktemp("case") / "case"))
    (made / "diagnosis.json").write_text(json.dumps({"schema": "diagnosis/1", "statement": "Cause: none."}))
    return made


def test_a_crate_describes_all_that_is_in_it(case: Path, tmp_path: Path, cli: Cli) -> None:
    from rocrate.rocrate import ROCrate  # slow to import

    out = tmp_path / "supplement"
    told = cli("export", case, RECORDING, "--crate", "--out", out).flat_err
    assert "license: not stated: write a licence into this file" in told
    crate = ROCrate(out)
    assert crate.name == "case"
    files = {e.id: e for e in crate.data_entities}
    assert set(files) == {"robot.yaml", "trials.csv", "diagnosis.json", RECORDING.name}
    assert set(files) | {"ro-crate-metadata.json"} == {p.name for p in out.iterdir()}
    for name, entity in files.items():
        assert entity["sha256"] == hashlib.sha256((out / name).read_bytes()).hexdigest()
    assert files["diagnosis.json"]["abstract"] == "Cause: none."
    units = {c["name"]: c["unitText"] for c in files["trials.csv"]["variableMeasured"]}
    assert set(units) == set(read_csv(case / "trials.csv").columns)
    assert (units["p1"], units["z"], units["trial"]) == ("Pa", "m", "1")
    assert crate.get("#robot")["additionalProperty"][0]["name"] == "length"
    recorded = crate.get(f"#recorded-{RECORDING.name}")
    assert recorded["result"].id == RECORDING.name and recorded["startTime"]
    assert crate.get("#analysed")["instrument"]["softwareVersion"]


def test_who_ran_it_is_the_agent_of_the_recording(tmp_path: Path) -> None:
    from rocrate.rocrate import ROCrate

    (tmp_path / "robot.yaml").write_text("name: finger\n")
    found = info(RECORDING)
    ran = {name: replace(found, metadata={"labels": {"operator": "Lin Ø."}}) for name in ("a.mcap", "b.mcap")}
    write_crate(tmp_path / "crate", [tmp_path / "robot.yaml"], Table(), {**ran, "c.mcap": found}, "runs")
    crate = ROCrate(tmp_path / "crate")
    agents = [crate.get(f"#recorded-{letter}.mcap").get("agent") for letter in "abc"]
    assert [agent and (agent.type, agent["name"]) for agent in agents] == [("Person", "Lin Ø.")] * 2 + [None]
    assert len([e for e in crate.get_entities() if e.type == "Person"]) == 1


@pytest.mark.parametrize(("options", "words"), [(["--case"], "is already a case"), ([], "has no streams")])
def test_a_case_has_no_streams(case: Path, tmp_path: Path, options: list[str], words: str, cli: Cli) -> None:
    assert words in cli("export", case, "--out", tmp_path, *options, code=2).err
    assert "give recordings" in cli("export", case / "robot.yaml", "--crate", "--out", tmp_path, code=2).err


# ------------------------------------------------------------------ symbolic links
PRECIOUS = "somebody's only copy"


WRITING = [
    "export RECORDING",
    "export RECORDING --case",
    "export RECORDING --crate",
    "export CASE RECORDING --crate",
    "compare CASE",
    "fit CASE",
    pytest.param("effects", marks=pytest.mark.long),
]
"""Commands that write into a folder."""


@pytest.mark.parametrize("words", WRITING)
def test_no_file_is_written_through_a_link(words: str, case: Path, tmp_path: Path, cli: Cli) -> None:
    told = [{"RECORDING": RECORDING, "CASE": case}.get(word, word) for word in words.split()]
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    elsewhere.mkdir()
    cli(*told, "--out", out)
    names = [path.name for path in out.iterdir() if path.is_file()]
    assert names
    for name in names:
        (out / name).unlink()
        (elsewhere / name).write_text(PRECIOUS)
        (out / name).symlink_to(elsewhere / name)
    cli(*told, "--out", out, "--replace")
    assert all((elsewhere / name).read_text() == PRECIOUS for name in names)
    assert not any((out / name).is_symlink() for name in names)


# ------------------------------------------------------------------ one folder, one output
def recordings(place: Path, *folders: str) -> list[Path]:
    """Recordings of the same name, each in a folder of its own."""
    files = [place / folder / "run.mcap" for folder in folders]
    for file in files:
        file.parent.mkdir(parents=True)
        shutil.copy(RECORDING, file)
    return files


def test_recordings_of_one_name_are_exported_apart(tmp_path: Path, cli: Cli) -> None:
    files = [*recordings(tmp_path, "a/x", "b/x"), *recordings(tmp_path, "c")]
    shutil.copy(RECORDING, tmp_path / "alone.mcap")
    cli("export", *files, tmp_path / "alone.mcap", "--out", tmp_path / "out")
    apart = ["a-x-run", "b-x-run", f"{tmp_path.name}-c-run", "alone"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(apart)
    said = cli("export", files[0], tmp_path / "a" / ".." / "a" / "x" / "run.mcap", "--out", tmp_path / "twice", code=2)
    assert "is given twice" in said.flat_err and not (tmp_path / "twice").exists()


@pytest.mark.parametrize("words", [*WRITING, "export CASE --crate", "diagnose CASE"])
def test_a_folder_that_holds_something_else_is_never_added_to(words: str, case: Path, tmp_path: Path, cli: Cli) -> None:
    verb, *told = ({"RECORDING": RECORDING, "CASE": case}.get(word, word) for word in words.split())
    out, option = tmp_path / "out", "--protocols" if verb == "diagnose" else "--out"
    out.mkdir()
    (out / "diagnosis.json").write_text(PRECIOUS)
    said = cli(verb, *told, option, out, code=2).flat_err
    assert f"{out}: holds diagnosis.json, which would remain" in said and "--replace" in said
    assert [path.read_text() for path in tmp_path.rglob("*") if path.is_file()] == [PRECIOUS]
    if verb in ("export", "effects"):
        cli(verb, *told, option, out, "--replace")
        assert {"diagnosis.json"} != {path.name for path in out.iterdir()}
        assert not any(path.read_bytes() == PRECIOUS.encode() for path in out.iterdir())
        assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_folder_is_replaced_as_a_whole_or_left_as_it_was(
    case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    (tmp_path / "out").mkdir(mode=0o750)
    (tmp_path / "out" / "old.csv").write_text(PRECIOUS)

    def fails(*_: object) -> None:
        raise OSError(28, "No space left on device", "trials.csv")

    with monkeypatch.context() as broken:
        broken.setattr("lab.verbs.export.write_crate", fails)
        cli("export", case, "--crate", "--out", tmp_path / "out", "--replace", code=1)
    assert [path.name for path in tmp_path.rglob("*")] == ["out", "old.csv"]
    cli("export", case, "--crate", "--out", tmp_path / "out", "--replace")
    held = {"ro-crate-metadata.json", "robot.yaml", "trials.csv", "diagnosis.json"}
    assert {path.name for path in tmp_path.rglob("*")} == {"out", *held}
    assert (tmp_path / "out").stat().st_mode & 0o777 == 0o750


def test_no_folder_is_replaced_that_holds_recordings_or_what_is_read(
    case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    (file,) = recordings(tmp_path, "runs")
    own = Path(shutil.copytree(case, tmp_path / "own"))
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "notes.txt").write_text(PRECIOUS)
    monkeypatch.chdir(tmp_path / "work")
    for given, out in ((file, file.parent), (case, file.parent), (own, own), (own, tmp_path), (case, Path("."))):
        said = cli("export", given, "--crate", "--out", out, "--replace", code=2).flat_err
        assert f"{out}: cannot be replaced, because that would delete" in said
    assert file.is_file() and (own / "trials.csv").is_file() and (tmp_path / "work" / "notes.txt").is_file()
    assert "is a file" in cli("export", case, "--crate", "--out", file, "--replace", code=2).flat_err
