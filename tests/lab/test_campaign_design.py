"""A campaign before anything moves: order, plan, limits, stop rules, journal, and what is wrong with its file."""

import itertools
import random
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import Cli

from lab.campaign.command import Stops
from lab.campaign.design import CampaignDesign, campaign_of, changes, fewest_changes, ordered, planned_table
from lab.campaign.journal import CampaignJournal, CampaignProgress, read
from lab.files.campaign_file import Stop
from lab.files.config import ConfigError
from lab.rig.operator import RememberingOperator
from model.effects.design import design_from_columns
from protocols.bench import Setup
from protocols.cycles import Cycles
from protocols.cycles import plan as cycles_plan
from protocols.errors import Stopped
from protocols.planned import cycles
from recordings.errors import BadJournal
from recordings.trials import Table, TrialRow
from tests.simulated.bench import raises

ROOT = Path(__file__).parent.parent.parent
EXAMPLE, RIG = ROOT / "examples" / "campaign" / "lengths.yaml", ROOT / "examples" / "rig" / "rig.yaml"
SMALL: dict[str, Any] = {
    "campaign": "small", "seed": 1, "blocks": 3,
    "protocols": [{"protocol": "bending", "parameters": {"pressures": ["60 kPa", "120 kPa"]},
                   "conditions": {"spine_lengths": [0, "5 cm"], "tip_mass": ["53 g", "80 g"]}}],
}  # fmt: skip


def campaign(folder: Path, **changes: Any) -> CampaignDesign:
    return campaign_of(written(folder, **changes), RIG, 99)


def written(folder: Path, **changes: Any) -> Path:
    path = folder / "campaign.yaml"
    path.write_text(yaml.safe_dump(SMALL | changes, sort_keys=False))
    return path


def refused(folder: Path, text: str) -> list[str]:
    path = folder / "campaign.yaml"
    path.write_text(text)
    return [line.removeprefix(f"{path}") for line in raises(ConfigError, None, campaign_of, path, RIG, 0).splitlines()]


# ------------------------------------------------------------------ order
@pytest.mark.parametrize("grouped", [True, False])
def test_each_block_holds_every_condition_once(grouped: bool) -> None:
    slots = ordered([["a", "a", "b", "b", "b"], ["b"]], 4, 3, grouped)
    assert Counter(slots) == Counter((block, cell) for block in range(1, 5) for cell in [*((0, k) for k in range(5)), (1, 0)])
    assert [cell[0] for _, cell in slots] == [0] * 20 + [1] * 4


def test_the_order_in_a_block_differs_from_block_to_block_and_follows_from_the_seed() -> None:
    slots = ordered([["a"] * 8], 3, 5, True)
    assert len({tuple(cell for block, cell in slots if block == k) for k in (1, 2, 3)}) == 3
    assert slots == ordered([["a"] * 8], 3, 5, True) != ordered([["a"] * 8], 3, 6, True)


def test_over_many_seeds_no_condition_comes_first_more_often_than_chance_has_it() -> None:
    first = Counter(ordered([["a"] * 4], 1, seed, True)[0][1][1] for seed in range(2000))
    assert all(400 < first[k] < 600 for k in range(4))


def test_hands_are_needed_once_a_set_up_unless_they_are_random() -> None:
    hands = [["a", "b", "c"] * 3]

    def needed(grouped: bool) -> int:
        return changes([[hands[0][cell[1]]] for _, cell in ordered(hands, 3, 1, grouped)])

    assert needed(True) == 3 and needed(False) > 9


@pytest.mark.parametrize("seed", range(20))
def test_no_other_order_of_set_ups_needs_fewer_hands(seed: int) -> None:
    rng = random.Random(seed)
    parts = [rng.sample("abcd", rng.randint(1, 3)) for _ in range(4)]
    found = fewest_changes(parts, rng)
    assert [sorted(f) for f in found] == [sorted(p) for p in parts]
    least = min(changes(orders) for orders in itertools.product(*(list(itertools.permutations(p)) for p in parts)))
    assert changes(found) == least


# ------------------------------------------------------------------ plan
def test_the_example_is_planned_with_its_cycles_and_hands(cli: Cli) -> None:
    said = cli("campaign", EXAMPLE, "--rig", RIG, "--plan", "--json").json
    assert said["hands"] == 2 and sum(len(run["hands"]) for run in said["runs"]) == 2
    by_chamber = {c["chamber"]: (c["cycles"], c["highest_pa"]) for c in said["chambers"]}
    # 30 bending runs and 9 elongations of one cycle each; 5 + 5 cycles of warm-up, since both groups have chamber 1
    assert by_chamber[1] == (30 + 9 + 5 + 5, 250e3) and by_chamber[4] == (9 + 5, 150e3)
    assert said["states"] == 30 * 11 + 9 * 6 and said["seed"] == 7 and len(said["runs"]) == 1 + 39
    assert said["rig_seconds"] == pytest.approx(sum(run["seconds"] for run in said["runs"]))
    text = cli("campaign", EXAMPLE, "--rig", RIG, "--plan").flat_out
    assert "39 runs, 384 states" in text and "hands are needed 2 times, the first time before the first run" in text


def test_a_plan_has_a_line_for_each_run_and_says_what_hands_do_and_what_is_allowed(tmp_path: Path, cli: Cli) -> None:
    push = {"protocol": "stiffness", "parameters": {"spine_lengths": ["8 cm"], "vacuum": "70 kPa"}}
    bend = {"protocol": "bending", "parameters": {"pressures": ["90 kPa"], "roll_deg": 40, "vacuums": ["70 kPa"]},
            "conditions": {"spine_lengths": ["5 cm"], "tip_mass": ["61 g", "122.5 g"]}}  # fmt: skip
    words = ["campaign", str(written(tmp_path, protocols=[push, bend], blocks=2)), "--rig", str(RIG), "--plan"]
    said = cli(*words, "--json").json
    text = cli(*words).out.splitlines()
    first = 1 + text.index(next(line for line in text if line.split()[:2] == ["run", "block"]))
    rows = text[first : first + len(said["runs"])]
    assert [row.split()[0] for row in rows if "warm-up" not in row] == [str(i) for i in range(1, 7)]
    assert all(run["condition"] in row for run, row in zip(said["runs"], rows, strict=True))
    assert text[first + len(rows)].startswith("6 runs")
    tasks = [line.strip() for line in text if line.startswith("  task ")]
    assert len(tasks) == said["hands"] == 3 and [f"task {i}" in "\n".join(rows) for i in (1, 2, 3, 4)] == [True] * 3 + [False]
    assert tasks[0] == (
        "task 1, before run 1: mount the bare spine at the stiffness stand; no mass at the tip; turn the mount to 0 deg; "
        "set the vacuum supply to 70 kPa below ambient"
    )
    assert tasks[1].startswith("task 2, before the warm-up: mount the robot in its frame, as robot.yaml's gravity has it, spine")
    assert tasks[1].endswith(" g at the tip; turn the mount to 40 deg")
    assert tasks[2] in [f"task 3, before run 5: hang {mass} g at the tip" for mass in ("61", "122.5")]
    assert "  pressure 90 kPa of 250 kPa allowed: ok" in text and "  tip mass 122.5 g" in text
    assert {m["name"]: m["value"] for m in said["largest"]}["total pressure"] == 270e3
    (counted,) = [line for line in text if "pressure cycles" in line]
    assert counted == "  chambers 1, 2, 9: 7 pressure cycles, up to 90 kPa"


def test_a_seed_that_the_file_does_not_give_is_drawn_and_kept(tmp_path: Path) -> None:
    assert campaign(tmp_path).file.seed == 1
    drawn = campaign(tmp_path, seed=None, stop={"max_duration": 5400, "max_scatter": 0.004})
    assert drawn.file.seed == 99 and not drawn.seed_given
    assert yaml.safe_load(drawn.yaml)["stop"]["max_scatter"] == "4 mm"
    (tmp_path / "again.yaml").write_text(drawn.yaml)
    again = campaign_of(tmp_path / "again.yaml", RIG, 5)
    assert again.digest == drawn.digest and again.seed_given and again.file == drawn.file


def test_the_digest_follows_what_is_done_and_not_when_it_ends(tmp_path: Path) -> None:
    as_it_is = campaign(tmp_path).digest
    same = campaign(tmp_path, stop={"max_failed": 5}, labels={"specimen": "a"}, warm_up={"cycles": 1}).digest
    other = campaign(tmp_path, protocols=[SMALL["protocols"][0] | {"parameters": {"pressures": ["60 kPa"]}}]).digest
    assert same == as_it_is and len({as_it_is, other, campaign(tmp_path, seed=2).digest}) == 3


def test_the_warm_up_goes_to_the_highest_pressure_of_each_group(tmp_path: Path) -> None:
    both = [*SMALL["protocols"], {"protocol": "elongation", "parameters": {"spine_lengths": [0]}}]
    found = campaign(tmp_path, protocols=both, warm_up={"cycles": 4})
    assert found.warm_up is not None and isinstance(found.warm_up.parameters, Cycles)
    groups = dict(zip(map(tuple, found.warm_up.parameters.chambers), found.warm_up.parameters.pressures, strict=True))
    assert groups == {(1, 2, 9): 120e3, tuple(range(1, 10)): 150e3} and found.warm_up.parameters.cycles == 4
    assert campaign(tmp_path, warm_up={"cycles": 0}).warm_up is None
    pushes = [{"protocol": "stiffness", "parameters": {"spine_lengths": [0.1]}}]
    assert campaign(tmp_path, protocols=pushes).warm_up is None


def test_a_warm_up_asks_for_nobody_s_hands(tmp_path: Path) -> None:
    found = campaign(tmp_path)
    assert found.hands == 2 == campaign(tmp_path, warm_up={"cycles": 0}).hands
    assert campaign(tmp_path, hands="random").hands > 2


def test_cycles_are_counted_from_vented() -> None:
    plan = cycles_plan(Cycles(chambers=[[1, 2], [2, 3]], pressures=[50e3, 80e3], cycles=3))
    count, highest = cycles(plan, 4)
    assert count.tolist() == [3, 6, 3, 0] and highest.tolist() == [50e3, 80e3, 80e3, 0.0]
    raises(ValueError, "2 values for 3 groups", Cycles, chambers=[[1], [2], [3]], pressures=[50e3, 80e3])


def test_the_planned_table_is_a_design_with_and_without_pushes(tmp_path: Path) -> None:
    found = campaign(tmp_path)
    table = planned_table(found, ("x", "y", "z"))
    design = design_from_columns(found.robot, table)
    assert len(design) == 4 * 3 * 5 and len(design.trial_id) == 12 and design.channels == ("x", "y", "z")
    assert (np.diff(table["t"]) > 0).all() and sorted(set(table["tip_mass"])) == [0.053, 0.08]
    assert "specimen" not in table and "x" not in planned_table(found)
    pushes = [{"protocol": "stiffness", "parameters": {"spine_lengths": [0.1], "steps": 3}}, *SMALL["protocols"]]
    mixed = planned_table(campaign(tmp_path, protocols=pushes), ("x", "y", "z", "force"))
    assert (mixed["protocol"] == "stiffness").sum() == 9 and set(mixed["specimen"]) == {"spine", ""}
    assert np.isnan(mixed["deflection"][mixed["protocol"] == "bending"]).all()
    assert design_from_columns(found.robot, mixed).stiffness.sum() == 9


def test_a_protocol_s_file_is_part_of_a_campaign(tmp_path: Path) -> None:
    (tmp_path / "creep.py").write_text((ROOT / "examples" / "protocol" / "creep.py").read_text())
    own = {"protocol": "creep.py", "parameters": {"times": [5, 20]}, "conditions": {"pressure": ["50 kPa", "90 kPa"]}}
    found = campaign(tmp_path, protocols=[own], blocks=1)
    table = planned_table(found)
    assert sorted(zip(table["p1"], table["hold"], strict=True)) == [(50e3, 5), (50e3, 20), (90e3, 5), (90e3, 20)]
    before = found.digest
    (tmp_path / "creep.py").write_text((tmp_path / "creep.py").read_text() + "\n# changed\n")
    assert campaign(tmp_path, protocols=[own], blocks=1).digest != before


# ------------------------------------------------------------------ what is wrong
def test_what_is_wrong_is_told_with_its_line(tmp_path: Path) -> None:
    assert refused(tmp_path, "campaign: a\nblock: 3\nprotocols:\n  - protocol: bending\n") == [
        ":2: block: unknown key; did you mean blocks?"
    ]
    (line,) = refused(tmp_path, "campaign: a\nprotocols:\n  - protocol: bendin\n")
    assert line.startswith(":3: protocol = 'bendin'") or "'bendin': must be one of" in line
    text = "campaign: a\nprotocols:\n- protocol: bending\n  parameters:\n    pressurs: [1 kPa]\n"
    text += "  conditions:\n    tip_mass:\n    - 50 g\n    - 5 kg\n"
    lines = refused(tmp_path, text)
    assert lines[0].startswith(":5: pressurs: unknown key; did you mean pressures?")
    assert any(line.startswith(":9: tip_mass = 5 kg: must be at most 1 kg") for line in lines) and len(lines) == 2
    (line,) = refused(tmp_path, "campaign: a b\nprotocols: [{protocol: bending}]\n")
    assert line.startswith(":1: campaign = 'a b'")
    both = "campaign: a\nprotocols:\n- protocol: bending\n  parameters: {tip_mass: 50 g}\n  conditions: {tip_mass: [50 g]}\n"
    assert "tip_mass: is in both parameters and conditions" in refused(tmp_path, both)[0]
    twice = "campaign: a\nprotocols:\n- protocol: bending\n  conditions: {tip_mass: [50 g, 50 g]}\n"
    assert "lists a value twice" in refused(tmp_path, twice)[0]
    taken = "campaign: a\nprotocols: [{protocol: bending}]\nlabels: {block: x}\n"
    assert "block: is set by the campaign itself" in refused(tmp_path, taken)[0]


def test_the_limits_of_all_runs_are_told_at_once_and_nothing_is_written(tmp_path: Path, cli: Cli) -> None:
    over = {"protocol": "bending", "conditions": {"pressures": [["290 kPa"], ["100 kPa"]], "spine_lengths": [0.35, 0.1]}}
    every = {"protocol": "elongation", "parameters": {"pressures": ["200 kPa"], "spine_lengths": [0.1]}}
    path = written(tmp_path, protocols=[*SMALL["protocols"], over, every])
    for how in (["--plan"], ["--out", str(tmp_path / "out")]):
        told = cli("campaign", path, "--rig", RIG, *how, code=2).err
        assert "pressures 290 kPa, spine_lengths 0.35: bending, step" in told and "requires 290 kPa" in told
        assert "elongation, step 3" in told and "requires a total over the chambers of 1800 kPa" in told
    assert not (tmp_path / "out").exists()


def test_wrong_usage_is_told(tmp_path: Path, cli: Cli) -> None:
    path = str(written(tmp_path))
    for words in (
        [],
        [path, "--resume", str(tmp_path)],
        ["--resume", str(tmp_path), "--plan"],
        ["--resume", str(tmp_path / "none")],
        ["--resume", str(tmp_path)],
        [path, "--tag", "block=3"],
    ):
        assert cli("campaign", *words, "--rig", RIG, code=2).err
    assert not (tmp_path / "small").exists()


# ------------------------------------------------------------------ stop rules, hands, journal
def row(x: float) -> Table:
    return Table.of([TrialRow(1, 1, "bending", 1, "load", 0.0, 0.0, (0.0,), tip=(x, 0.0, 0.4))])


def test_each_stop_rule_says_why(tmp_path: Path) -> None:
    plan, done = campaign(tmp_path).runs[0].job.plan, CampaignProgress("c", "d", {})
    assert Stops(Stop(), 9).before(plan, done) == Stops(Stop(), 9).after(done) == ""
    done.seconds, done.lost = 100.0, 7
    assert "max_duration" in Stops(Stop(max_duration=100.0 + plan.seconds - 1.0), 9).before(plan, done)
    assert Stops(Stop(max_duration=100.0 + plan.seconds), 9).before(plan, done) == ""
    worn = Stops(Stop(max_cycles=3), 9)
    worn.count(plan, 2)
    assert worn.before(plan, done) == ""
    worn.count(plan)
    assert "chamber 1 was inflated 3 times" in worn.before(plan, done)
    assert "7 samples" in Stops(Stop(max_lost=6), 9).after(done) and Stops(Stop(max_lost=7), 9).after(done) == ""
    failing = Stops(Stop(max_failed=2), 9)
    failing.failed = 1
    assert failing.after(done) == ""
    failing.failed = 2
    assert "max_failed" in failing.after(done)
    slips = Stops(Stop(max_scatter=2e-3), 9)
    slips.take((0, 1), row(0.0))
    slips.take((0, 2), row(0.1))  # another condition
    slips.take((0, 1), row(3.9e-3))
    assert slips.after(done) == ""
    slips.take((0, 2), row(0.1041))
    assert "condition 3, trial 1 step 1 scatters by 2.05 mm" in slips.after(done)


class Person:
    def __init__(self) -> None:
        self.prepared: list[Setup] = []
        self.willing = True

    def prepare(self, setup: Setup) -> None:
        if not self.willing:
            raise Stopped("no")
        self.prepared.append(setup)

    def confirm(self, trouble: str) -> None:
        """Always."""


def test_a_person_is_asked_when_the_set_up_changes_and_not_before_every_run() -> None:
    person, light, heavy = Person(), Setup("robot", 0.05, 0.0, 80e3), Setup("robot", 0.1, 0.0, 80e3)
    hands = RememberingOperator().over(person)
    for setup in (light, light, heavy, heavy, light):
        hands.prepare(setup)
    assert person.prepared == [light, heavy, light] and hands.asked == 3
    person.willing = False
    raises(Stopped, None, hands.prepare, heavy)
    person.willing = True
    hands.prepare(light)  # how far it was changed is not known
    assert hands.asked == 4


def test_a_journal_tells_what_is_done_although_its_last_line_is_torn(tmp_path: Path) -> None:
    with CampaignJournal.begin(tmp_path, "c", "d", {"specimen": "S"}) as journal:
        raises(ConfigError, "going on in another process", CampaignJournal.reopen, tmp_path)
        journal.began(1)
        journal.ended(1, "completed", 10.0, 5, 2, True)
        journal.began(2)
        journal.ended(2, "failed", 3.0, 1, 0, False)
        journal.began(2)
    raises(ConfigError, "holds a campaign already", CampaignJournal.begin, tmp_path, "c", "d", {})
    with (tmp_path / "campaign.journal").open("a") as file:
        file.write('{"run": 2, "outco')
    done = read(tmp_path / "campaign.journal")
    assert done.completed == {1} and done.begun == {1: 1, 2: 2} and done.seconds == 13.0
    assert (done.rows, done.lost, done.labels) == (5, 2, {"specimen": "S"}) and done.inflated > 0
    with CampaignJournal.reopen(tmp_path) as journal:
        journal.ended(2, "completed", 10.0, 5, 0, True)
    assert read(tmp_path / "campaign.journal").completed == {1, 2}


@pytest.mark.parametrize(
    "text",
    ["", "[]\n", "{}\n", '{"campaign_journal": 2}\n', '{"campaign_journal": 1, "campaign": "c", "design": "d", "labels": []}\n',
     '{"campaign_journal": 1, "campaign": "c", "design": "d", "labels": {}}\n{"run": -1, "begun": 0}\n',
     '{"campaign_journal": 1, "campaign": "c", "design": "d", "labels": {}}\n{"run": 1, "outcome": "completed"}\n'],
)  # fmt: skip
def test_a_journal_that_cannot_be_right_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "campaign.journal").write_text(text)
    raises(BadJournal, None, read, tmp_path / "campaign.journal")
