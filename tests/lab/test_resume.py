"""A run that was killed or stopped, or whose files go meanwhile: it goes on from what is recorded. Campaigns on fakes: the table
is the planned one, and neither Ctrl-C nor a kill nor a fault loses or doubles a state."""

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import SOUND, Cli, command
from terminal import Terminal
from virtual_lab import VirtualLab, go_on, journal_says, lab, meanwhile, press_ctrl_c, recorded, settings

import timing
from benchmarks.faults.night import write_campaign
from lab.campaign.design import campaign_of, planned_table
from lab.files.checked import recording_of
from lab.files.inputs import read_case
from lab.verbs import run as run_verb
from lab.verbs.fakes import PATIENT_SETTLE
from recordings.campaign.labels import RECORD
from recordings.campaign.shelf import runs
from recordings.file.journal import read
from recordings.file.reader import Recording
from recordings.file.verify import verify
from tests.simulated.bench import wait_until

SHORT = settings("spine_lengths=[0.0, 3 cm, 6 cm]", "pressures=[80 kPa]", "unload=false", *PATIENT_SETTLE[1:])


def freed(virtual_lab: VirtualLab) -> None:
    """What a person does after a crash: look at the rig, bring it into the safe state, say that it is."""
    wait_until(lambda: lab("safe", "--clear", "--rig", virtual_lab.rig) == 0, 120)


def test_a_killed_run_is_resumed_from_its_first_unfinished_trial(real_lab: VirtualLab, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    with command("run", "bending", "--rig", real_lab.rig, *SHORT, "--out", broken) as process:
        assert timing.wait(lambda: journal_says('{"trial": 2, "step": 1}', broken) or process.poll() is not None, 120)
        assert process.poll() is None, process.communicate()[0]
    (first,) = broken.glob("*.mcap")
    freed(real_lab)
    assert lab("run", "--resume", first, "--rig", real_lab.rig) in SOUND

    (journal,) = broken.glob("*.journal")
    progress = read(journal)
    assert progress.done == {1: 2, 2: 2, 3: 2} and [n for _, n in progress.recordings] == [1, 2]
    second = broken / progress.recordings[1][0]
    assert {row.row.trial for row in Recording.open(second).trials} == {2, 3}
    # The unfinished sweep was begun again: its first state is there twice, in two files, and once in the table.
    assert 2 in {event.row.trial for event in Recording.open(first, truncated=True).trials}
    assert lab("recover", first, "--out", broken / "first.mcap") == 3
    assert lab("recover", first) == 3  # as the how-to has it: the torn file, its recovered one and the resumed run together
    together = [first, broken / f"{first.stem}-recovered.mcap", second]
    assert read_case(together).table.rows == read_case([second, broken / "first.mcap"]).table.rows
    assert [(run.planned, run.rows) for run in runs(broken) if run.path == second.name] == [(6, 4)]
    resumed = read_case([second, broken / "first.mcap"]).table
    assert [(r.trial, r.step, r.repeat, r.branch) for r in resumed] == [(t, s, 1, "load") for t in (1, 2, 3) for s in (1, 2)]
    assert resumed["spine_length"] == pytest.approx([0.0, 0.0, 0.03, 0.03, 0.06, 0.06], abs=1e-3)
    assert [round(r.pressures[8], -4) for r in resumed] == [0.0, 80e3] * 3
    assert (resumed["t"][1:] > resumed["t"][:-1]).all() and set(read_case([second]).table.columns) <= set(resumed.columns)

    assert lab("run", "--resume", journal, "--rig", real_lab.rig) in SOUND
    assert read_case([second, broken / "first.mcap"]).table.rows == resumed.rows


def test_a_stopped_run_goes_on_as_it_said_with_the_protocol_that_it_recorded_and_others_code_is_not_executed(
    virtual_lab: VirtualLab, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, folder = tmp_path / "sine.py", tmp_path / "with blank"
    own.write_text("from protocols import bending\n" + BENDING)
    meanwhile(lambda: journal_says('{"trial": 2, "step": 1}', folder), press_ctrl_c)
    said = ("--operator", "Ada", "--tag", "batch=3")
    words = go_on(cli("run", own, "--rig", virtual_lab.rig, *SHORT, "--out", folder, *said, code=1).both)
    own.unlink()
    (first,) = folder.glob("*.mcap")
    assert words == ["lab", "run", "--resume", str(first), "--rig", str(virtual_lab.rig)]
    with monkeypatch.context() as another:
        another.setattr(os, "getuid", lambda: 12345)
        assert "is not yours; give its protocol: lab run sine.py --resume" in cli(*words[1:], code=2).err
    assert lab(*words[1:], "--tag", "batch=4") in SOUND
    (second,) = set(folder.glob("*.mcap")) - {first}
    assert Recording.open(first).metadata[RECORD] == {"operator": "Ada", "batch": "3"}
    assert Recording.open(second).metadata[RECORD] == {"operator": "Ada", "batch": "4"}
    assert {row.trial for row in read_case([first, second]).table} == {1, 2, 3}
    assert Recording.open(second).attachments["protocol.py"] == Recording.open(first).attachments["protocol.py"]


def test_what_cannot_be_resumed_is_told(virtual_lab: VirtualLab, tmp_path: Path, cli: Cli) -> None:
    (tmp_path / "a.journal").write_text(
        '{"journal": 1, "campaign": "c", "protocol": "bending"}\n{"recording": "gone.mcap", "first_trial": 1}\n'
    )
    assert "gone.mcap" in cli("run", "--resume", tmp_path / "a.journal", "--rig", virtual_lab.rig, code=2).err
    assert lab("run", "--resume", tmp_path / "a.journal", "--rig", virtual_lab.rig, "--set", "repeats=2") == 2
    assert lab("run", "--rig", virtual_lab.rig) == 2


# ------------------------------------------------------------------ files and terminals that go
READ = '{"trial": 1, "step": 1}'
BENDING = "PARAMETERS, NEEDS, plan, run = bending.PARAMETERS, bending.NEEDS, bending.plan, bending.run\n"


def truncate(folder: Path) -> None:
    os.truncate(next(folder.glob("*.mcap")), 30_000)


@pytest.mark.parametrize("harm", [
    pytest.param(lambda folder: next(folder.glob("*.mcap")).unlink(), id="file deleted"),
    pytest.param(truncate, marks=pytest.mark.long),
    pytest.param(lambda folder: folder.rename(folder.with_name("moved")), marks=pytest.mark.long, id="folder renamed"),
])  # fmt: skip
def test_a_run_whose_recording_is_lost_lands_after_the_state_and_goes_on_from_the_rescue_file(
    harm: Callable[[Path], None], virtual_lab: VirtualLab, tmp_path: Path, cli: Cli
) -> None:
    rig = tmp_path / "rig" / "rig.yaml"
    shutil.copytree(virtual_lab.rig.parent, rig.parent)
    folder = tmp_path / "out"
    files: list[Path] = []
    meanwhile(lambda: journal_says(READ, folder), lambda: files.extend(folder.glob("*.mcap")), lambda: harm(folder))
    output = cli("run", "bending", "--rig", rig, *SHORT, "--out", folder, code=3).both
    (file,) = files
    (rescue,) = rig.parent.glob("*-rescue.mcap")
    told = "".join(output.split())
    assert str(file) in told and f"statesin{rescue}" in told and "Traceback" not in output
    assert verify(rescue).ok and lab("info", rescue) == (3 if harm is truncate else 0)
    found = Recording.open(rescue)
    assert found.outcome == "stopped" and any(str(file) in line.text for line in found.log if line.level == "error")
    assert found.metadata["outcome"]["safe_state"] == "confirmed" and len(found.trials) < 6
    assert lab("replay", rescue) == 0 or harm is truncate
    assert lab(*go_on(output)[1:]) in SOUND
    second = max((p for p in rig.parent.glob("*.mcap") if p != rescue), key=lambda p: p.stat().st_mtime)
    assert {row.trial for row in read_case([rescue, second]).table} == {1, 2, 3}


def test_what_was_read_is_attached_whatever_the_files_hold_by_then(
    virtual_lab: VirtualLab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(virtual_lab.rig.parent, tmp_path / "rig")
    rig, robot, own = tmp_path / "rig" / "rig.yaml", tmp_path / "rig" / "robot.yaml", tmp_path / "bending.py"
    own.write_text("from protocols import bending\n" + BENDING)
    before = {"rig.yaml": rig.read_bytes(), "robot.yaml": robot.read_bytes(), "protocol.py": own.read_bytes()}
    connect = run_verb.connect

    def edited(*how: object, **more: object) -> None:
        connect(*how, **more)  # type: ignore[arg-type]
        for path in (rig, robot, own):
            path.write_text("edited: yes\n")

    monkeypatch.setattr(run_verb, "connect", edited)
    out = tmp_path / os.fsdecode(b"M\xfcller")  # which is no UTF-8
    assert lab("run", own, "--rig", rig, *SHORT, "--set", "spine_lengths=[0.0]", "--out", out) in SOUND
    (file,) = out.glob("*.mcap")
    assert recording_of(rig) == file
    found = Recording.open(file)
    assert {name: found.attachments[name] for name in before} == before
    sums = {name: hashlib.sha256(data).hexdigest() for name, data in found.attachments.items()}
    assert found.metadata["sha256"] == sums and "protocol.yaml" in sums


@pytest.mark.parametrize("asked", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_closed_terminal_ends_a_run_as_a_signal_to_end_does(asked: bool, real_lab: VirtualLab, tmp_path: Path) -> None:
    freed(real_lab)
    rig = real_lab.rig.with_name("at_terminal.yaml")
    rig.write_text(yaml.safe_dump({**yaml.safe_load(real_lab.rig.read_text()), "operator": "console"}))
    holding = settings("reading=hold", "hold_times=[1, 400]")  # the terminal is closed before the second state
    with Terminal("run", "bending", "--rig", rig, *SHORT, *holding, "--out", tmp_path) as terminal:
        terminal.until("Enter when ready")
        if not asked:
            terminal.press("\n")
            assert timing.wait(lambda: journal_says(READ, tmp_path), 120), terminal.shown
        terminal.hang_up()
        assert terminal.end() == 1
    found = Recording.open(recorded(tmp_path))
    assert found.outcome == "stopped" and found.metadata["outcome"]["safe_state"] == "confirmed"
    assert verify(found.path).ok
    assert not rig.with_suffix(".latch").exists()


# ------------------------------------------------------------------ campaigns
TWO_LEVELS = {"pressures": ["60 kPa", "100 kPa"]}
EVERY_WAY = {
    "campaign": "ways", "seed": 2, "blocks": 1, "warm_up": {"cycles": 0}, "stop": {"max_failed": 10},
    "protocols": [
        {"protocol": "stiffness", "parameters": {"spine_lengths": [0.1], "steps": 3, "min_samples": 30, "zero_samples": 20}},
        {"protocol": "bending", "parameters": TWO_LEVELS, "conditions": {"spine_lengths": [0.04]}},
        {"protocol": "bending", "parameters": {**TWO_LEVELS, "spine_lengths": [0.0], "reading": "hold", "hold_times": [4.0, 12.0],
                                               "unload": False, "zero_state": False}},
        {"protocol": "bending", "parameters": {**TWO_LEVELS, "spine_lengths": [0.0], "reading": "sweep", "repeats": 2,
                                               "rate": "5 kPa/s", "settle": {"average": "4.8 s"}}},
        {"protocol": "elongation", "parameters": {**TWO_LEVELS, "spine_lengths": [0.0], "tip_mass": "80 g"}},
    ],
}  # fmt: skip


def test_a_campaign_gives_the_table_that_was_planned(virtual_lab: VirtualLab, tmp_path: Path) -> None:
    file = tmp_path / "ways.yaml"
    file.write_text(json.dumps(EVERY_WAY))
    planned = planned_table(campaign_of(file, virtual_lab.rig, 0))
    assert lab("campaign", file, "--rig", virtual_lab.rig, "--out", tmp_path / "ways") in SOUND
    table = read_case(sorted((tmp_path / "ways").glob("*/*.mcap"))).table
    assert set(planned) <= set(table.columns) and len(table) == len(planned["trial"])
    for name in ("trial", "step", "protocol", "repeat", "branch", "rate", "tip_mass", "roll_deg", "specimen"):
        assert table[name].tolist() == planned[name].tolist(), name
    near = {"spine_length": 1e-3, "vacuum": 5e3, "deflection": 2e-3} | {f"p{c}": 4e3 for c in range(1, 10)}
    for name, within in near.items():
        np.testing.assert_allclose(table[name], planned[name], atol=within, rtol=0, err_msg=name)
    swept = planned["hold"] == 0
    held = (planned["hold"] == 4.0) | (planned["hold"] == 12.0)
    assert swept.sum() == 6 and (table["hold"][swept] == 0).all() and held.sum() == 4
    np.testing.assert_allclose(table["hold"][held], planned["hold"][held], atol=1.5)
    assert (table["hold"][~swept & ~held] > 0.5).all() and (planned["hold"][~swept & ~held] > 0.5).all()


def test_a_stopped_campaign_goes_on_by_the_line_it_printed(virtual_lab: VirtualLab, tmp_path: Path, cli: Cli) -> None:
    folder = tmp_path / "with blank"
    file = write_campaign(tmp_path / "night.yaml", (0.0, 0.03), 1, unload=False)
    command = ["campaign", file, "--rig", virtual_lab.rig, "--out", folder]
    meanwhile(lambda: journal_says('"step"', next(folder.glob("0001-*"), folder)), press_ctrl_c)
    words = go_on(cli(*command, "--operator", "Ada", code=1).both)
    assert words == ["lab", "campaign", "--resume", str(folder), "--rig", str(virtual_lab.rig)]
    assert lab(*words[1:]) in SOUND
    table = read_case(sorted(folder.glob("*/*.mcap"))).table
    assert [(r.trial, r.step) for r in table] == [(t, s) for t in (1, 2) for s in (1, 2, 3)]
    found = runs(folder, where=[("campaign", "night"), ("operator", "Ada")])
    assert {run.labels.get("run", "warm-up") for run in found} == {"warm-up", "1", "2"}
    assert {run.protocol for run in found if "run" not in run.labels} == {"cycles"}  # its recording has no states
    (second,) = [run for run in found if run.labels.get("run") == "2"]
    assert second.labels["block"] == "1" and second.labels["condition"].startswith("spine_lengths 0.0")
    journal = (folder / "campaign.journal").read_text()
    assert lab(*words[1:], "--json") in SOUND and (folder / "campaign.journal").read_text() == journal  # nothing is left

    changed = yaml.safe_load((folder / "campaign.yaml").read_text()) | {"blocks": 2}
    (folder / "campaign.yaml").write_text(yaml.safe_dump(changed))
    assert lab(*words[1:]) == 2
    assert lab(*command) == 2  # the folder holds a campaign


def test_a_crash_between_a_run_s_end_and_the_journal_does_not_run_it_again(virtual_lab: VirtualLab, tmp_path: Path) -> None:
    file, folder = write_campaign(tmp_path / "night.yaml", (0.0,), 1, unload=False), tmp_path / "night"
    assert lab("campaign", file, "--rig", virtual_lab.rig, "--out", folder) in SOUND
    journal = folder / "campaign.journal"
    lines = journal.read_text().splitlines()
    assert '"outcome": "completed"' in lines[-1]
    journal.write_text("\n".join(lines[:-1]) + "\n" + lines[-1][:20])
    before = sorted(folder.rglob("*.mcap"))
    assert lab("campaign", "--resume", folder / "campaign.yaml", "--rig", virtual_lab.rig) in SOUND
    assert sorted(folder.rglob("*.mcap")) == before and '"outcome": "completed"' in journal.read_text().splitlines()[-1]
    assert lab("campaign", "--resume", folder, "--rig", virtual_lab.rig, "--out", "x") == 2
