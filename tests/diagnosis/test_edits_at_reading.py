"""When a table is read, wrong units, wrong frames and mistakes in robot.yaml are named; unusual robots are left alone."""

import itertools
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lab
from diagnosis.edits.edit import Variants
from diagnosis.edits.listed import FRAMES
from diagnosis.edits.reading import Reading, read
from diagnosis.remedies import named, of_frame
from lab.files.robot_numbers import doubts
from model.actuators import Chambers
from model.condition import conditions
from model.robot import Robot, load_robot
from model.rods import FINE, solve
from model.section import rods_of
from model.stated import Stated
from recordings.trials import AXES, Mapped, Table, TrialRow

ROBOT = load_robot(Path(__file__).parents[2] / "examples/paper/robot.yaml")
LEVELS = (0.0, 60e3, 120e3, 180e3, 240e3)
BENDING = (9, 1, 2)
EVERY = tuple(range(1, 10))
Change = Callable[[TrialRow], TrialRow]


def sweep(
    robot: Robot | None = None,
    levels: Sequence[float] = LEVELS,
    chambers: Sequence[int] = BENDING,
    rolls: Sequence[float] = (0.0,),
    bias: float = 0.0,
    spines: Sequence[float] = (0.0, 0.2),
) -> tuple[TrialRow, ...]:
    """What the rod model says, with a little noise: up at each spine length and roll (degrees)."""
    robot = robot or ROBOT
    asked = [(s, roll, p) for s in spines for roll in rolls for p in levels]
    every = range(1, 1 + len(robot.actuators.azimuths_deg))
    pressure = np.array([[bias + (p if c in chambers else 0.0) for c in every] for _, _, p in asked])
    spine, roll = np.array([a[0] for a in asked]), np.array([a[1] for a in asked])
    states = conditions(robot, spine, pressure, robot.tip_mass, np.radians(roll))
    result = solve(rods_of(robot, states), FINE)
    assert result.converged.all()
    rng = np.random.default_rng(1)
    tip = result.tip + rng.normal(0, 0.3e-3, result.tip.shape)
    pressure = pressure + rng.normal(0, 100.0, pressure.shape)
    return tuple(
        TrialRow(
            trial=1 + i // len(levels), step=1 + i % len(levels), protocol="bending", repeat=1, branch="load", t=10.0 * i,
            spine_length=float(spine[i]), vacuum=80e3, tip_mass=robot.tip_mass, roll_deg=float(roll[i]),
            pressures=tuple(pressure[i].tolist()), tip=tuple(tip[i].tolist()),
            orientation=tuple(result.orientation[i].tolist()),
        )
        for i in range(len(asked))
    )  # fmt: skip


def pressures(factor: float, offset: float = 0.0) -> Change:
    return lambda r: replace(r, pressures=tuple((p + offset) * factor for p in r.pressures))


def positions(factor: float) -> Change:
    return lambda r: replace(r, tip=tuple(c * factor for c in r.tip or ()))  # type: ignore[arg-type]


def reading(robot: Robot, rows: Iterable[TrialRow]) -> Reading:
    return read(robot, Table.of(rows))


SILENT = Reading((), ())


@pytest.mark.parametrize(
    ("states", "change", "words"),
    [
        (5, pressures(1 / 6894.76), ["pressures must be 6895 times as large", "look like psi"]),
        (5, pressures(1.0, 84_000.0), ["absolute", "subtract 83"]),
        (5, lambda r: replace(r, tip=(r.tip[0], -r.tip[1], -r.tip[2])), ["the cameras' frame", "hold what is now x, ", "-z"]),  # type: ignore[index]
        (5, lambda r: replace(r, tip=(r.tip[0], r.tip[1], r.tip[2] - 0.404)), ["displacement from the rest", "add 0.4 to z"]),  # type: ignore[index]
        (2, lambda r: replace(r, orientation=(0.0, 12.0, -40.0, 3.0)), ["norm 41.9", "unit quaternion"]),
        (2, lambda r: replace(r, spine_length=r.spine_length * 1000), ["spine_length", "200 m", "mm", "divide by 1000"]),
        (2, lambda r: replace(r, tip_mass=53.0), ["tip_mass", "53 kg", "looks like g", "divide by 1000"]),
    ],
)  # fmt: skip
def test_another_unit_or_frame_is_refused_with_what_to_write(states: int, change: Change, words: list[str]) -> None:
    text = "; ".join(reading(ROBOT, map(change, sweep(spines=(0.2,))[:states])).refused)
    assert all(word in text for word in words), text


def test_masses_in_grams_are_refused_with_the_line_of_the_map() -> None:
    table = replace(Table.of([replace(r, tip_mass=53.0) for r in sweep(spines=(0.2,))[:2]]), mapped=Mapped())
    assert any("looks like g; write `unit: g` under columns.tip_mass in map.yaml" in text for text in read(ROBOT, table).refused)


@pytest.mark.parametrize(("unit", "wrong", "factor"), [("psi", "kPa", 6.895), ("kPa", "mbar", 10.0), ("psi", "bar", 0.06895)])
def test_a_unit_of_all_pressures_is_named_next_to_an_area_factor_that_does_the_same(unit: str, wrong: str, factor: float) -> None:
    robot = lab.load_robot(Path(__file__).parents[2] / "examples/three_chambers/robot.yaml")
    rows = [replace(r, pressures=tuple(p / factor for p in r.pressures)) for k in (1, 2, 3) for r in three(robot, k, 1.0)]
    for mapped in (None, Mapped(unit=wrong)):
        found = read(robot, replace(Table.of(rows), mapped=mapped))
        (text,) = (*found.refused, *found.asked)
        assert re.search(rf"{factor:.4g}\d? times as large \(p = (0.[5-9]\d|1.00)\): they look like {unit} read as {wrong}", text)
        assert bool(found.refused) or "or area_factor or the modulus of robot.yaml is" in text


def test_a_unit_is_read_off_relative_to_that_of_the_map() -> None:
    (text,) = read(ROBOT, replace(Table.of(map(pressures(0.01), sweep(spines=(0.2,)))), mapped=Mapped(unit="kPa"))).refused
    assert "100 times as large" in text and "look like bar" in text


@pytest.mark.parametrize(
    ("straight", "scale", "said"),
    [("at rest", (1, 1, 4), "along z the tip moves"), ("as recorded", (1, 1, 4), "correct unit or scale of z in map.yaml"),
     ("as recorded", (6, 6, 6), "m apart")],
)  # fmt: skip
def test_a_forgotten_scale_comes_before_the_place_of_the_base(straight: str, scale: tuple[int, int, int], said: str) -> None:
    rows = [row for chambers in (BENDING, (5, 6)) for row in sweep(chambers=chambers, spines=(0.0,))]
    base = np.array([0.0, 0.0, (1 - scale[2]) * rows[0].tip[2] if straight == "at rest" else 0.2])  # type: ignore[index]
    table = Table.of(replace(r, tip=tuple((np.array(r.tip) * scale + base).tolist())) for r in rows)
    found = read(ROBOT, replace(table, mapped=Mapped(straight=straight)))  # type: ignore[arg-type]
    text = "; ".join((*found.refused, *found.asked))
    assert said in text and bool(found.refused) == (straight != "at rest"), text
    assert ("`scale`" in text and "straight:" not in text) or scale[2] == 4 != base[2], text


def test_columns_that_are_exchanged_without_the_place_of_the_base_are_named() -> None:
    base, rows = np.array([1.2, -0.6, 0.8]), sweep(spines=(0.2,))
    exchanged = [replace(r, tip=tuple(((np.array(r.tip) + base)[[1, 0, 2]] - base).tolist())) for r in rows]
    (text,) = read(ROBOT, replace(Table.of(exchanged), mapped=Mapped(base=tuple(base.tolist())))).refused
    assert "columns x and y are exchanged" in text and "not their `zero`" in text


@pytest.mark.parametrize("shift", [(300, 0, 0), (0, 0, -300), (-250, 300, 350), (0, 0, 1600)])
@pytest.mark.parametrize("signed", [False, True])
def test_places_displaced_by_any_length_are_named_and_a_zero_of_the_wrong_sign(shift: tuple[float, ...], signed: bool) -> None:
    by, seen = 1e-3 * np.array(shift), Mapped(("-y", "z", "-x"))
    in_file = by @ seen.axes
    base = np.where(in_file == 0, [0.1, 0.0, 0.04], -in_file / 2)  # as it is written
    rows = [row for chambers in (BENDING, (5, 6)) for row in sweep(chambers=chambers, spines=(0.0,))]
    moved = Table.of(replace(r, tip=tuple((np.array(r.tip) + by).tolist())) for r in rows)
    found = read(ROBOT, replace(moved, mapped=replace(seen, base=tuple(base.tolist())) if signed else None))  # type: ignore[arg-type]
    (text,) = (*found.refused, *found.asked)
    given = re.search(r"displaced by \[(.*?)\] mm", text)
    assert given is not None and [*map(float, given[1].split(", "))] == pytest.approx(shift, abs=4), text
    wrong = [f"columns.{a}" for a, s in zip("xyz", in_file, strict=True) if s]
    said = f"change the sign of `zero` of {', '.join(wrong)} in map.yaml" if signed else f"subtract [{given[1]}] mm from"
    assert said in text and "instead" not in text, text


@pytest.mark.parametrize("call", [False, True])
def test_the_remedy_of_a_frame_brings_each_file_to_the_base_from_any_present_frame(call: bool) -> None:
    for present, axes in itertools.product(FRAMES, FRAMES):
        if np.linalg.det(present) < 0:
            continue
        text = of_frame(axes, Mapped(tuple(named(present)), call))
        given = re.search("frame[=:] ?{(.*)}", text)
        words = named(present) if given is None else re.findall(r': "?(-?[xyz])', given[1])
        columns = np.eye(3)
        for axis in re.findall("sign of column ([xyz])", text):
            columns["xyz".index(axis)] *= -1
        for pair in re.findall("swap columns ([xyz]) and ([xyz])", text):
            columns[["xyz".index(a) for a in pair]] = columns[["xyz".index(a) for a in pair[::-1]]]
        written = np.array([AXES[name] for name in words])
        assert np.linalg.det(written) > 0 and np.array_equal(written @ columns, axes @ present), text


def test_each_thing_that_is_wrong_gets_one_line() -> None:
    w_last = [replace(r, orientation=(*r.orientation[1:], r.orientation[0])) for r in sweep(spines=(0.2,)) if r.orientation]
    found = reading(ROBOT, (pressures(1e-3)(positions(100.0)(r)) for r in w_last)).refused
    said = ("columns x, y, z", "looks like cm", "divide by 100", "like kPa", "qw, qx, qy, qz", "hold x, y, z, w: exchange the")
    assert len(found) == 3 and all(any(words in line for line in found) for words in said), found


def test_a_roll_in_rad_is_seen_by_where_the_tip_goes() -> None:
    rows = sweep(rolls=(0.0, 40.0, 120.0), spines=(0.0,))
    assert reading(ROBOT, rows) == SILENT
    (text,) = reading(ROBOT, (replace(r, roll_deg=float(np.radians(r.roll_deg or 0.0))) for r in rows)).asked
    assert "roll_deg" in text and "looks like rad" in text and "multiply by 57.2958" in text


def test_a_modulus_in_another_unit_is_asked_about_with_what_would_fit() -> None:
    (text,) = reading(ROBOT.with_modulus(1000), sweep(spines=(0.0,))).asked
    assert "youngs_modulus" in text and "kPa" in text


def test_a_chamber_that_does_nothing_and_pressures_far_above_the_robots_are_asked_about() -> None:
    told = lab.load_robot(Path(__file__).parents[2] / "examples/three_chambers/robot.yaml")
    rows = [r for k in (1, 2, 3) for r in three(told, k, 0.0 if k == 2 else 1.0)]
    assert "chamber 2 gets no pressure" in " ".join(reading(told, rows).asked)
    high = [replace(r, pressures=tuple(6.895 * p for p in r.pressures)) for k in (1, 2, 3) for r in three(told, k, 1.0)]
    text = " ".join(doubts(told, Table.of(high), "robot.yaml"))
    assert "552 kPa" in text and "max_pressure of 80 kPa" in text and "unit" in text
    assert "look like kPa read as psi" in " ".join(reading(told, high).refused)


def three(robot: Robot, chamber: int, acts: float) -> tuple[TrialRow, ...]:
    """A sweep of one chamber of three, of which `acts` of the pressure arrives."""
    made = sweep(robot, (0.0, 20e3, 40e3, 60e3, 80e3), (chamber,), spines=(0.0,))
    still = sweep(robot, (0.0,) * 5, (chamber,), spines=(0.0,))
    rows = (replace(r, tip=r.tip if acts else s.tip, trial=chamber) for r, s in zip(made, still, strict=True))
    return tuple(replace(r, vacuum=None) for r in rows)


# ------------------------------------------------------------------ what is odd but right
SAGS = {"gravity": (9.81, 0.0, 0.0), "youngs_modulus": 200e3, "shear_modulus": 67e3}
UPRIGHT = {"gravity": (0.0, 0.0, -9.81), "tip_mass": 2.4}
LIMP = ROBOT.model_copy(update={"youngs_modulus": 2e4, "shear_modulus": 7e3, "gravity": (0.0, 0.0, -9.81)})


@pytest.mark.parametrize("factor", [0.2, 1.0, pytest.param(5.0, marks=pytest.mark.long)])
def test_a_modulus_that_is_far_off_is_no_other_unit(factor: float) -> None:
    judged = reading(ROBOT.with_modulus(factor), sweep(spines=(0.2,)))
    assert not judged.refused and all(text.startswith("youngs_modulus 5") for text in judged.asked)


@pytest.mark.parametrize(
    "rows",
    [
        sweep(levels=(80e3, 160e3, 240e3)),
        sweep(levels=(0.0,)),
        sweep(levels=(100e3, 101e3, 150e3, 200e3), chambers=EVERY),
        sweep(levels=(0.0, 40e3, 80e3, 120e3), bias=100e3),
        sweep(levels=(0.0, 400.0, 800.0, 1200.0)),
        sweep(rolls=(0.0, 0.7, 1.3), spines=(0.0,)),
        sweep(rolls=(0.0, 90.0, 180.0), spines=(0.0,)),
        sweep(rolls=(1.0,), spines=(0.0,)),
    ],
    ids=["no rest", "rest alone", "stretched by 100 kPa", "stiffened by 100 kPa", "hardly any pressure", "small rolls",
         "rolls in degrees", "one roll"],
)  # fmt: skip
def test_an_unusual_campaign_is_left_alone(rows: tuple[TrialRow, ...]) -> None:
    assert reading(ROBOT, rows) == SILENT


def test_a_tip_that_weights_move_while_regulators_hum_is_no_other_unit() -> None:
    rng = np.random.default_rng(3)
    rows = [
        replace(
            r, pressures=tuple(rng.normal(0, 40.0, 9).tolist()), tip=(-0.03 * i, 0.0, 0.39), tip_mass=0.1 * i, orientation=None
        )
        for i, r in enumerate(sweep(spines=(0.2,)))
    ]
    assert not reading(ROBOT, rows).refused


UP = Rotation.from_euler("x", 90, degrees=True)
ASKEW, YAW = Rotation.from_euler("zy", (90, -90), degrees=True), Rotation.from_euler("z", 25, degrees=True)

MOUNTED = Mapped(("y", "z", "x"), mount=(0.0, 0.9063, 0.0, 0.4226))


def misread(turn: Rotation, scalar_first: bool) -> Rotation:
    """As `MOUNTED` makes it of the file's quaternions, if these are read in the other order."""
    onto, mount = Rotation.from_matrix(MOUNTED.axes), Rotation.from_quat(MOUNTED.mount, scalar_first=True)
    file = onto.inv() * turn * mount.inv() * onto
    return onto * Rotation.from_quat(file.as_quat(scalar_first=scalar_first), scalar_first=not scalar_first) * onto.inv() * mount


@pytest.mark.parametrize(
    ("change", "remedy", "mapped"),
    [
        (lambda turn: UP * turn, "from the left by [0.707, -0.707, 0, 0]", None),
        (lambda turn: UP * turn, "from the left by [0.707, 0, -0.707, 0]", Mapped(("y", "z", "x"))),
        (lambda turn: turn * ASKEW, "from the right by [0.5, 0.5, 0.5, -0.5]", None),
        (lambda turn: turn * ASKEW, "`mount: [0.5, 0.5, 0.5, -0.5]` under orientation in map.yaml", Mapped(("y", "z", "x"))),
        (lambda turn: turn * YAW, "`mount: [0.976, 0, 0, -0.216]`", Mapped(("y", "z", "x"))),
        (
            lambda turn: turn * YAW,
            "write `mount: [0.216, 0, 0, 0.976]` under orientation in map.yaml",
            Mapped(mount=(0, 0, 0, 1)),
        ),
        (lambda turn: UP * turn * UP.inv(), "and from the right by [0.707, 0.707, 0, 0]", None),
        (lambda turn: turn.inv(), "change the sign of qx, qy and qz", None),
        (lambda turn: misread(turn, False), "write `orientation: {order: xyzw, ..}` in map.yaml", MOUNTED),
        (lambda turn: misread(turn, True), "write `orientation: {order: wxyz, ..}` in map.yaml", MOUNTED),
    ],
    ids=["world", "world mapped", "body", "body mapped", "body askew", "body mounted", "frame", "inverse", "x first", "w first"],
)
def test_attitudes_in_another_frame_than_the_tips_are_refused_with_the_turn_that_is_missing(
    change: Callable[[Rotation], Rotation], remedy: str, mapped: Mapped | None
) -> None:
    rows = []
    for chambers in (BENDING, (3, 4, 5), (6, 7, 8)):
        for r in sweep(chambers=chambers, spines=(0.0,)):
            shown = change(Rotation.from_quat(r.orientation, scalar_first=True))
            rows.append(replace(r, orientation=tuple(shown.as_quat(scalar_first=True).tolist())))
    (text,) = read(ROBOT, replace(Table.of(rows), mapped=mapped)).refused
    assert "are in another frame or order than its positions" in text and remedy in text, text


def test_a_frame_that_explains_tips_and_orientations_is_named_although_the_mount_is_in_its_axes() -> None:
    mount, quarter = Rotation.from_quat([0, 1, 0, 1]), Rotation.from_euler("z", 90, degrees=True)
    rows = []
    for r in (r for chambers in (BENDING, (3, 4, 5)) for r in sweep(chambers=chambers, spines=(0.0,))):
        turn = quarter * Rotation.from_quat(r.orientation, scalar_first=True) * mount.inv() * quarter.inv() * mount
        tip = tuple(quarter.apply(r.tip).tolist())
        rows.append(replace(r, tip=tip, orientation=tuple(turn.as_quat(scalar_first=True).tolist())))
    found = read(ROBOT, replace(Table.of(rows), mapped=Mapped(mount=tuple(mount.as_quat(scalar_first=True).tolist()))))
    assert not found.refused and "write `frame: {x: y, y: -x, z: z}` in map.yaml" in found.asked[0]


@pytest.mark.parametrize(("stated", "top", "sides"), [(SAGS, 60e3, (BENDING, (3, 4, 5))), (UPRIGHT, 20e3, (BENDING,))])
def test_bodies_that_sag_or_lean_are_left_alone(stated: dict[str, object], top: float, sides: Sequence[Sequence[int]]) -> None:
    robot = ROBOT.model_copy(update=stated)
    rows = [r for side in sides for r in sweep(robot, (0.0, top / 3, top / 1.5, top), side, spines=(0.0,))]
    assert abs(np.median([r.tip[0] for r in rows])) > 0.1 * (stated is SAGS) and reading(robot, rows) == SILENT  # type: ignore[index]


def test_a_body_too_limp_to_stand_may_hang_anywhere() -> None:
    hanging = [replace(r, tip=(0.05, 0.0, -0.37)) for r in sweep(levels=(0.0, 0.0))]
    assert "all places are displaced by [" in " ".join(reading(ROBOT, hanging).asked)
    assert not reading(LIMP, hanging).refused


def test_a_point_tracked_beyond_the_end_may_be_farther_away() -> None:
    def beyond(r: TrialRow) -> TrialRow:
        x, y, z = r.tip  # type: ignore[misc]
        return replace(r, tip=(x, y, z + 0.5 * ROBOT.length))

    rows = tuple(map(beyond, sweep(levels=(0.0, 60e3))))
    stated = {"marker_offset": {"z": Stated(value=0.5 * ROBOT.length, unit="m")}}
    assert "m from the base of a robot" in " ".join(reading(ROBOT, rows).refused)
    assert not reading(ROBOT.model_copy(update={"effects": stated}), rows).refused


@pytest.mark.parametrize(
    "effects",
    [
        {"chamber_azimuth": {"angle": Stated(value=0.5, unit="rad")}},
        {"chamber_gain": {name: Stated(value=value, unit="1") for name, value in (("x", 0.3), ("y", -0.2), ("single", 1.0))}},
        {"tether_load": {"x": Stated(value=1.0, unit="N"), "y": Stated(value=-0.7, unit="N")}},
    ],
    ids=["turned by 29 degrees", "one strong chamber", "pulled aside"],
)  # fmt: skip
def test_a_robot_that_bends_oddly_is_not_asked_about_its_columns(effects: dict[str, dict[str, Stated]]) -> None:
    odd = ROBOT.model_copy(update={"effects": effects})
    rows = [row for chambers in ((9, 1, 2), (3, 4, 5), (6, 7, 8)) for row in sweep(odd, chambers=chambers, spines=(0.0,))]
    assert reading(ROBOT, rows) == SILENT
    changed = [replace(r, pressures=(*r.pressures[3:6], *r.pressures[:3], *r.pressures[6:])) for r in rows]
    assert "counted the other way round" in " ".join(reading(ROBOT, changed).asked)


@pytest.mark.parametrize("pair", [(0, 2), (1, 3)])
def test_exchanged_chambers_of_four_are_named(pair: tuple[int, int]) -> None:
    four = ROBOT.model_copy(update={"chambers": Chambers(radius=0.008, path_radius=0.0385, azimuths_deg=(0, 90, 180, 270))})
    rows = [row for chambers in ((1,), (2,), (3,), (4,)) for row in sweep(four, chambers=chambers, spines=(0.0,))]
    order = [{pair[0]: pair[1], pair[1]: pair[0]}.get(k, k) for k in range(4)]
    said = " ".join(reading(four, [replace(r, pressures=tuple(r.pressures[k] for k in order)) for r in rows]).asked)
    assert f"chambers {pair[0] + 1} and {pair[1] + 1} are swapped (p = " in said


def test_a_moment_turns_with_its_frame_and_is_no_vector_where_the_frame_is_mirrored() -> None:
    rows = [replace(r, sensors={f"tip_moment_{a}": m for a, m in zip("xyz", (0.1, 0.2, 0.3), strict=True)}) for r in sweep()]
    turned = Variants.of(ROBOT, Table.of(rows)).turned(np.array([[np.sqrt(0.5), 0, 0, np.sqrt(0.5)]]), np.array([-1, 1, 1]))
    _, table = turned.written()
    assert [table[f"tip_moment_{a}"][0] for a in "xyz"] == pytest.approx([-0.2, -0.1, -0.3])


# ------------------------------------------------------------------ pushes
def pushes(force: float = 1.0, deflection: float = 1.0, modulus: float = 1.0) -> list[TrialRow]:
    """A stiffness trial of the body, 2 to 10 mm."""
    second = np.pi / 4 * (ROBOT.outer_radius**4 - ROBOT.inner_radius**4)
    stiff = 3 * modulus * ROBOT.youngs_modulus * second / ROBOT.length**3
    return [
        TrialRow(
            trial=1, step=i, protocol="stiffness", repeat=1, branch="load", t=float(i), spine_length=0.0, pressures=(0.0,) * 9,
            specimen="body", force=(0.05 + stiff * 0.002 * i) * force, deflection=0.002 * i * deflection,
        )
        for i in range(1, 6)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (pushes(force=1000.0), ["column force", "looks like mN", "divide by 1000"]),
        (pushes(force=1000 / 9.80665), ["column force", "looks like gram-force", "divide by 101.972"]),
        (pushes(deflection=1000.0), ["column deflection", "looks like mm", "divide by 1000"]),
    ],
)
def test_a_push_in_another_unit_is_named(rows: list[TrialRow], words: list[str]) -> None:
    (text,) = reading(ROBOT, rows).refused
    assert all(word in text for word in words), text


@pytest.mark.parametrize("modulus", [0.1, 0.5, 3.0, 10.0])
def test_a_modulus_that_is_to_be_found_is_no_other_unit_of_force(modulus: float) -> None:
    assert reading(ROBOT, pushes(modulus=modulus)) == SILENT


@pytest.mark.parametrize("factor", [0.5, pytest.param(1.0, marks=pytest.mark.long)])
def test_a_body_that_sags_upwards_is_asked_about(factor: float) -> None:
    level = ROBOT.model_copy(update={"gravity": (-9.81, 0.0, 0.0)})
    rows = sweep(level, spines=(0.0,), levels=(0.0, 10e3, 20e3))
    told = level.with_modulus(factor)
    assert reading(told, rows) == SILENT
    across = ((0.0, 0.0, 9.81), (0.0, -9.81, 0.0)) if factor >= 1 else ()  # a body twice as soft sags by as much too far
    for wrong in ((9.81, 0.0, 0.0), *across):
        (text,) = reading(told.model_copy(update={"gravity": wrong}), rows).asked
        stated = ", ".join(f"{g:g}" for g in wrong)
        assert f"gravity [-9.81, 0, 0] instead of [{stated}] m/s^2" in text


def test_a_resting_tip_far_from_where_the_model_stands_is_asked_about() -> None:
    rows = sweep(ROBOT, spines=(0.0,), levels=(0.0, 10e3, 20e3))
    nearer = [replace(r, tip=tuple(0.7 * x for x in r.tip or ())) for r in rows]
    assert reading(ROBOT, rows) == SILENT
    assert "all places are displaced by [0, 0.2, -120.6] mm" in " ".join(reading(ROBOT, nearer).asked)
