"""Messages of an answer: a code, the values behind it, and one text template for each code.

The terminal, the page and diagnosis.json show the same text; programs read code and values. Templates name what drives the robot
by fields of `model.actuators.Words` such as {pressures}, so one template serves chambers and tendons.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from model.actuators import Chambers, Words

Severity = Literal["critical", "warning", "note"]
"""critical: resolve it before you trust the answer; warning: it limits the answer; note: what was done."""


@dataclass(frozen=True)
class Finding:
    """One concern, note or reason, with its text."""

    code: str
    severity: Severity
    text: str
    values: Mapping[str, Any] = field(default_factory=dict)
    """Values in the text, in its units; a list of findings if the text lists them."""

    def __str__(self) -> str:
        return self.text


def finding(code: str, words: Words = Chambers.words, /, **values: Any) -> Finding:
    """Return the finding of a code, with `values` and the words for the robot's actuators filled into its template.

    >>> str(finding("states_not_finite", left_out=1, states=7))
    '1 of 7 states have values that are not finite and are ignored'
    """
    severity = SEVERITY[code]
    shown = {k: "; ".join(map(str, v)) if isinstance(v, list | tuple) else v for k, v in values.items()}
    return Finding(code, severity, words.fill(TEMPLATES[severity][code], **shown), values)


TEMPLATES: Mapping[Severity, Mapping[str, str]] = {
    "critical": {
        "refitted_first": (
            "robot.yaml or the table is too far from the model, so this was changed first: {changes}. The best fit misses by "
            "{before_mm:.2f} mm without and {after_mm:.2f} mm with it (rms, outliers down-weighted). The answer assumes it. "
            "Check it: until then no cause is reported as certain"
        ),
        "beyond_tolerance": (
            "{fit} moves values of robot.yaml beyond their tolerance (one standard deviation in brackets): {numbers}. "
            "Re-measure these values or widen their uncertainty; until then no cause is reported as certain"
        ),
        "thrust_likely": (
            "robot.yaml does not say whether cap or walls take the thrust of the {actuators}. After calibration {walls_mm:.2f} "
            "mm rms remain with the walls, {cap_mm:.2f} mm with the cap, which does not settle it. The walls are assumed. Write "
            "`thrust: walls` or `thrust: cap` and diagnose again; until then no cause is reported as certain"
        ),
        "drift": (
            "from the first to the last of {trials} trials{hours} the robot at rest drifts by {mm:.1f} mm: {points}; {what}. "
            "Until this is settled no cause is certain, as calibration may absorb it. Fix cameras and base, let the robot warm "
            "up, and read the robot at rest in each trial. If all points move together, subtract from each trial, in columns x, "
            "y, z and those of markers, how far its rest differs from that of the first (one `zero` in map.yaml for all trials "
            "does not remove a drift), and diagnose again"
        ),
        "shifted": (
            "{first} to {last} ({states} states): positions are logged {by} {when}. There they miss those of all other states at "
            "like settings by {own_mm:.1f} mm, with the settings {by} {where} by {mm:.1f} mm (mean): was a row lost, or logged "
            "twice at a restart? Move columns x, y, z and those of markers {by} {back} there; until then no cause is certain"
        ),
        "stiffness_far_off": (
            "the fit needs a body {stiffness:.2g} times as stiff as robot.yaml's, or {pressures} {pressure_ratio:.2g} times as "
            "high. Check youngs_modulus, outer_radius, path_radius and area_factor of robot.yaml, and the unit of the "
            "{pressures}{units}; until then no cause is reported as certain"
        ),
        "unconfirmed_guesses": (
            "{are} unconfirmed ({guesses}): check and correct each in {path}, move it to `confirmed`, and import with that map"
        ),
    },
    "warning": {
        "as_read": "{text}",
        "one_spine_length": (
            "only one spine length: effects of the spine cannot be distinguished from those of the body; record at least two "
            "lengths"
        ),
        "one_pressure": (
            "only one {pressure}: no cause can be distinguished from a wrong {actuator_area}; record at least two {pressures}"
        ),
        "not_bent": "no state is bent: {actuators}, stiffness and material cannot be judged; record a bending sweep",
        "not_repeated": (
            "most states were read in one trial only, so differences between trials are uncertain and no cause is named; repeat "
            "the sweep three times"
        ),
        "repeated_within_trials": (
            "states were repeated within one trial only, so differences between trials are unknown. If the robot was driven anew "
            "for each repeat, {remedy}"
        ),
        "repeated_once": (
            "the median state was read in only two trials: the noise floor is uncertain, and so are the probabilities; repeat "
            "the sweep three times"
        ),
        "moved_to_model": (
            "`straight: {straight}` moved tip and markers to the model. A shift of base or origin cannot show; a tilted base, a "
            "turned frame, a tip marker off its place and a wrong weight show only by what changes with the {pressure}; a frame "
            "turned about z looks like {actuators} at another azimuth, unless robot.yaml states how well its turn is known "
            "(`uncertainty`, frame_turn). To tell them apart, measure the base's place and x axis in the cameras' frame, turn "
            "the positions to it, give the place as `zero` of columns x, y, z, and leave out `straight`"
        ),
        "tracked_turn": "the tracked body is turned by {deg:.1f} deg about {about} on the tip (allowed for): {remedy}",
        "marker_off_axis": (
            "marker {number} is at rest {off:.3g} mm from where robot.yaml has it, and is ignored: if it is fixed there, write "
            "`{entry}` as its entry of `markers` in robot.yaml; else give the centre of its section in the table"
        ),
        "marker_out_of_reach": (
            "marker {number} is {off:.3g} m from the body, beyond its reach, but the tip is not: the unit of the marker's "
            "columns is probably wrong. It is ignored: write `unit` under points.m{number}, or its columns, in map.yaml"
        ),
        "no_unload": (
            "no unload branch: friction, creep and a time lag cannot be distinguished; read the states on the way down too"
        ),
        "only_stiffness_trials": (
            "only stiffness trials: {actuators}, {pressures}, loads on the robot, base and cameras cannot be judged, only "
            "effects that change these readings are considered, probabilities were calibrated on bending campaigns: record one"
        ),
        "deflections_not_repeated": (
            "stiffness trials: deflections {how}, so the default scatter of touch point, zero and jamming is "
            "assumed; repeat them three times"
        ),
        "one_stiffness_length": (
            "stiffness trials at only one spine length: modulus, sensor zero and touch point cannot be distinguished; measure"
            " at two or more"
        ),
        "scatter_of_repeats": (
            "repeats of a state scatter by {floor_mm:.2f} mm rms, the noise floor: {scatter}{worst}. Find out why before you "
            "trust a cause"
        ),
        "ramps_assumed": (
            "the times of {effect} rest on how fast set-points change, which the table does not state; assumed: {assumed}. "
            "State it, as in `constants: {{rate: 1 bar/s, hold: 5 s}}` of map.yaml"
        ),
        "stage_error": (
            "an additional free-form error in the {stage} that {varies} would gain {gain:.1f} in log evidence: the named cause "
            "may not be the only one"
        ),
        "cause_impossible": "the cause is not certain: the fitted size of {effect} is physically impossible",
        "cause_undetermined": (
            "the cause is not certain: the data do not exclude that {effect} moves the tip by only {low_mm:.2f} mm (lower end of "
            "its 95 % interval over all hypotheses; the noise floor is {floor_mm:.2f} mm)"
        ),
        "cause_hidden_at_rest": (
            "the cause is not certain: {others} would look nearly the same, as `straight: {straight}` hides where the robot rests"
        ),
        "fit_not_reached": (
            "the cause is not certain: {effect} alone closes {alone:.0%} of the reducible gap (in-sample), with tolerances of "
            "other effects {together:.0%} (unseen states)"
        ),
        "cause_or_calibration": "the cause is not certain: {effect} alone would explain the data without calibration",
        "law_of_another_form": "the cause is not certain: known laws of {effect} fit only roughly; another cause may fit better",
        "gap_remains": "the cause is not certain: {mm:.2g} mm remain on unseen states",
    },
    "note": {
        "states_not_finite": "{left_out} of {states} states have values that are not finite and are ignored",
        "thrust_settled": (
            "robot.yaml does not say whether cap or walls take the thrust of the {actuators}. After calibration {walls_mm:.2f} "
            "mm rms remain with the walls, {cap_mm:.2f} mm with the cap; the walls are used. To settle it, write `thrust: walls`"
        ),
        "refitted": "{name} {found:.4g} {unit} instead of {given:.4g} {unit} (p = {p:.2f}){limit}{rather}",
        "length_differs": (
            "length {found:.4g} {unit} instead of {given:.4g} {unit} (p = {p:.2f}): measure it without {pressure}, from the base "
            "to the tracked point, and correct length in robot.yaml, or `sensor` in map.yaml{rather}"
        ),
        "arc_differs": (
            "marker {number} is at arc length {found:.4g} mm instead of {given:.4g} mm (p = {p:.2f}): measure it along the body "
            "from the base, without {pressure}, and write `markers: [{line}]` in robot.yaml{rather}"
        ),
        "gravity_elsewhere": (
            "gravity {found} instead of {given} m/s^2 (p = {p:.2f}): correct gravity in robot.yaml; it points down in the base "
            "frame{rather}"
        ),
        "base_tilted": (
            "the base is tilted by {about} (p = {p:.2f}), but robot.yaml says gravity {given}: level the base, or state the tilt "
            "in robot.yaml (effects, base_tilt){rather}"
        ),
        "frame_turned": "the cameras' frame is turned by {angle:.0f} deg about {about} (p = {p:.2f}): {remedy}{rather}",
        "frame_mirrored": "the cameras' frame is a mirror image of the base's (p = {p:.2f}): {remedy}{rather}",
        "origin_elsewhere": "all places are displaced by [{x:.4g}, {y:.4g}, {z:.4g}] mm (p = {p:.2f}): {remedy}{rather}",
        "frame_moved": (
            "the cameras' frame moved by {mm:.1f} mm at trial {trial} (p = {p:.2f}): subtract {by} from the tips from that trial "
            "on, or make two cases{rather}"
        ),
        "actuators_exchanged": ("{actuators} {first} and {second} are swapped (p = {p:.2f}): {remedy}{rather}"),
        "azimuths_elsewhere": "{how} (p = {p:.2f}): write `azimuths_deg: {line}` in robot.yaml{rather}",
        "actuator_dead": (
            "{actuator} {number} gets no {pressure} (p = {p:.2f}): check its connection and column p{number}{rather}"
        ),
        "column_in_unit": (
            "column {heading} must be {factor:.5g} times as large (p = {p:.2f}): it looks like {looks}; {remedy}{rather}"
        ),
        "stiffness_unit": (
            "{place}, column {column}: {value:.4g} {si} is {ratio:.2g} times the stiffness expected from robot.yaml's modulus; "
            "it looks like {looks} (p = {p:.2f}). Write {si}: {remedy}"
        ),
        "pressures_in_unit": (
            "the {pressures} must be {factor:.5g} times as large (p = {p:.2f}): they look like {looks}; {remedy}{rather}"
        ),
        "pressures_without_unit": (
            "nothing says the unit of the {pressures}, so they were read as Pa, up to {highest:.4g}: if they are in {unit}, "
            "{remedy}"
        ),
        "places_in_unit": "all positions hold {unit} read as {wrong} (p = {p:.2f}, x {factor:.4g}): {remedy}{rather}",
        "axis_in_unit": "column {heading} holds {unit} read as {wrong} (x {factor:.4g}, p = {p:.2f}): {remedy}{rather}",
        "attitudes_elsewhere": (
            "the tip's orientations (qw, qx, qy, qz) are in another frame or order than its positions (p = {p:.2f}): "
            "{remedy}{rather}"
        ),
        "displacements": (
            "columns x, y, z look like the displacement from the rest position (p = {p:.2f}); at rest the tip must be near "
            "(0, 0, {length:g}) m: add {length:g} to z{rather}"
        ),
        "points_exchanged": (
            "the tip and marker {number} are swapped (p = {p:.2f}): swap their columns in the table, or points in its map{rather}"
        ),
        "axes_of_point": (
            "{point} uses other axes (p = {p:.2f}): along the base's axes its columns are {axes}; check columns x, y, z{rather}"
        ),
        "scale_far_off": (
            "the tip moves {factor:.2g} times as far as robot.yaml predicts for these {pressures}: check the unit and scale of "
            "the {pressures}, the moduli, radii and path_radius"
        ),
        "axis_stretched": (
            "along {axis} the tip moves {factor:.2g} times as far as robot.yaml's model can be brought to, {mm:.3g} mm (sd): "
            "check unit and `scale` of that coordinate first"
        ),
        "tip_far_off": (
            "the tip is {mm:.3g} mm (rms, outliers down-weighted) from robot.yaml's prediction, and no single mistake explains "
            "it: check which marker is the tip, the frame, the columns x, y, z and p1 .., gravity, tip_mass, moduli, stiffness"
        ),
        "roll_in_rad": "column roll_deg looks like rad (p = {p:.2f}): multiply by 57.2958{rather}",
        "pressures_absolute": ("the {pressures} are absolute (p = {p:.2f}): subtract {ambient:.6g} Pa from all of them{rather}"),
        "number_moved": "{name} {by:.3g} {unit} {side} robot.yaml ({sd:.3g} {sd_unit})",
        "within_with_effect": "or {effect}, with which {numbers} would stay within their tolerance",
        "known_together": "the readings hardly tell {names} apart: change all of them or none",
        "gauge_looks_alike": (
            "a gauge or regulator of one {actuator} that reads wrong by this factor looks the same: first compare all on one "
            "{pressure}"
        ),
        "obstacle_stands": (
            "the obstacle stands at {azimuth:.0f} deg about the base's z from x, {mm:.1f} mm from this axis: look there, and "
            "state obstacle_azimuth_deg"
        ),
        "held_out_as_diagnosed": "the robot.yaml of --holdout differs in {keys}; the diagnosed one is used for both",
        "residual_ignored": "the learned residual in robot.yaml is ignored; it could mask the cause",
        "not_considered": "not considered: {why}",
    },
}
"""Severity -> code -> text."""
SEVERITY = {code: severity for severity, texts in TEMPLATES.items() for code in texts}
