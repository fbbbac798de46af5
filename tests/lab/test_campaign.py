"""Campaigns on fakes: the table is the planned one, and neither Ctrl-C nor a kill nor a fault loses or doubles a state."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import SOUND, Cli
from virtual_lab import VirtualLab, go_on, journal_says, lab, meanwhile, press_ctrl_c

from benchmarks.faults.night import KILL, Night, Trouble, write_campaign
from lab.campaign.design import campaign_of, planned_table
from lab.files.inputs import read_case
from recordings.campaign.labels import RECORD
from recordings.campaign.shelf import runs
from recordings.file.reader import Recording

SHORT = {"pressures": ["60 kPa", "100 kPa"]}
EVERY_WAY = {
    "campaign": "ways", "seed": 2, "blocks": 1, "warm_up": {"cycles": 0}, "stop": {"max_failed": 10},
    "protocols": [
        {"protocol": "stiffness", "parameters": {"spine_lengths": [0.1], "steps": 3, "min_samples": 30, "zero_samples": 20}},
        {"protocol": "bending", "parameters": SHORT, "conditions": {"spine_lengths": [0.04]}},
        {"protocol": "bending", "parameters": {**SHORT, "spine_lengths": [0.0], "reading": "hold", "hold_times": [4.0, 12.0],
                                               "unload": False, "zero_state": False}},
        {"protocol": "bending", "parameters": {**SHORT, "spine_lengths": [0.0], "reading": "sweep", "repeats": 2,
                                               "rate": "5 kPa/s", "settle": {"average": "4.8 s"}}},
        {"protocol": "elongation", "parameters": {**SHORT, "spine_lengths": [0.0], "tip_mass": "80 g"}},
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


@pytest.mark.long
def test_a_night_with_kills_and_a_fault_loses_nothing_and_doubles_nothing(real_lab: VirtualLab, tmp_path: Path) -> None:
    file = write_campaign(tmp_path / "night.yaml", (0.0, 0.03, 0.06), 1, unload=False)
    troubles = (Trouble(0, 0, KILL, 0.3), Trouble(2, 2, KILL), Trouble(3, 1, "gauge silence"))
    report = Night(real_lab.fakes, real_lab.rig, file, tmp_path / "night", troubles).go()
    assert report.kills == 2 and report.faults == 1 and report.sessions >= 3 and report.torn >= 1
    assert report.planned == report.found == 9 and report.sound, report
    torn = [Recording.open(f) for f in (tmp_path / "night").glob("0002-*/*-recovered.mcap")]
    assert len(torn) == 1 and torn[0].metadata[RECORD]["run"] == "2"
    lines = [json.loads(line) for line in (tmp_path / "night" / "campaign.journal").read_text().splitlines()]
    assert sorted(line["run"] for line in lines if line.get("outcome") == "completed" and "run" in line) == [1, 2, 3]


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
