"""Every number that decides an answer: its meaning, its reason, and how it was chosen.

`Chosen on` marks what was tuned; *the practice robots* have known causes whose laws the catalogue does not contain, and none of
them counts in a published score. Every other number is a convention, or one at which a test of its own purpose still passes.

Elsewhere stand the plausible sizes of effects and tolerances, the widest part of the prior: with each law (`model/effects/laws`,
`model/effects/tolerance`); numbers of an instrument: robot.yaml, rig.yaml, or `data.noise_estimate` and
`inference.reading_noise`; which readings were meant to be the same: `data.levels`; limits beyond which a table is refused:
`data.plausible`; and what only buys speed: next to the loop that it bounds.
"""

from __future__ import annotations

import numpy as np

# ------------------------------------------------------------------ prior
PRIOR_OF_NUMBER = {0: 0.12, 1: 0.66, 2: 0.16, 3: 0.012}
"""Prior share of hypotheses that name this many effects; the remainder, 0.048, is a cause outside the catalogue. One cause is
the usual case; chosen before any score was taken."""
PRIOR_OF_MORE = 0.075
"""Factor of that share for each further effect, as from two to three."""
TOLERATED_SIZES = np.array([0.0, 0.08, 0.16])
"""Standard deviation of every effect that a hypothesis does not name, plausible sizes; equally probable. Small effects act on
every robot."""
LOAD_SIZES = np.array([1.0, 10.0])
"""Standard deviation of forces, masses, stiffnesses and compliances that a hypothesis names, plausible sizes; equally probable: a
cable does not know how soft the body is, by which these are scaled, and were it held near that, stiffness, area and frame would
take up the rest. Searches and written numbers have the largest."""
LAW_ERRORS = np.array([0.03, 0.1, 0.3])
"""Share of an effect by which its law may be wrong; equally probable. An exact law would let a second effect absorb the error of
the first (decision 062)."""
DISCREPANCY_SIZES, DISCREPANCY_WEIGHTS = np.array([0.0, 0.1, 0.25]), np.array([0.5, 0.3, 0.2])
"""Standard deviation of the smooth discrepancy next to effects of the catalogue, noise floors, and its prior."""
DISCREPANCY_UNIT_RANGE = (5e-4, 5e-3)
"""Robot lengths; the noise floor in which the discrepancy is counted is kept within this range, so that neither very good nor
very bad cameras decide how wrong laws are."""
LEAST_NOISE_FLOOR = 1e-6
"""m; a table whose repeats agree better than any camera reads, as a simulator's do, has this noise floor."""
CORRELATION_LENGTH, CORRELATION_PRESSURE, BRANCH_DISTANCE = 0.35, 0.45, 0.5
"""Correlation lengths of the discrepancy: robot lengths of spine, highest pressures, and half the distance between loading and
unloading, in correlation lengths. About a third of the range, as smooth functions of so few states need."""
CORRELATION_TIME = 0.35
"""Correlation time of a stage's free-form error, durations of the campaign."""
DISCREPANCY_AT_REST = 0.3
"""Size of the discrepancy at zero pressure, of that at the highest."""
LEAST_NAMED_SIZE = 0.35
"""Smallest size of a named effect, plausible sizes, where its mm are not known: twice the largest tolerated size."""
LEAST_NAMED_FLOORS = 1.0
"""Noise floors that a named effect must carry to first order: less is nobody's cause."""
LARGEST_TOLERATED_SIZE = 0.5
"""Largest size of an effect that is not named, plausible sizes."""
GEOMETRY_LAW_ERROR = 0.1
"""Share of a law's error that remains where the law is geometry, such as a turned mount."""
LEAKAGE = 0.3
"""Share of a law's error that may act where the effect itself does nothing."""

# ------------------------------------------------------------------ noise
COMPONENT_LOG_SD = 0.7
"""Prior standard deviation of the logarithm of each noise component: a factor of two about its default."""
COMPONENT_RANGE = 20.0
"""Largest factor by which a noise component is larger or smaller than its default."""
DRIFT_TRIALS = 5
"""Fewest trials in which a drift is looked for: the order of fewer says too little."""
DRIFT_ORDERS = 199
"""Random orders of the trials that are tried; a drift (p < 0.005) fits their own order better than all of these."""
DRIFT_SCATTERS = 2.0
"""Least drift, in rms distances of repeats without it: less is lost in their scatter."""
DRIFT_TOGETHER = 0.35
"""Largest difference between the motions of two points that count as one translation, as a share of the motion."""
DRIFT_SD = 1.0
"""Prior standard deviation of drift, relative: far more than any robot has."""
LASTING_SHARE, LASTING_LOGIT_SD = 0.3, 1.5
"""Share of a variance that lasts over several readings, and prior standard deviation of its logit."""
MEMORY, MEMORY_LOG_SD, LONGEST_MEMORY = 1.25, 1.0, 37.5
"""Time over which lasting errors are forgotten, paces of the campaign, prior standard deviation of its logarithm, and the
longest: beyond is drift."""

SHIFTS = (-2, -1, 1, 2)
"""Rows by which places may be late (negative) or early."""
SHIFT_DEGREE, SHIFT_ROWS_PER_TERM, SHIFT_TERMS = 4, 4, 150
"""Highest degree of the polynomial in the settings, fewest states for each of its terms, and most terms: a sweep is smooth."""
SHIFT_ROUNDS = 3
"""How often polynomial and rows are fitted in turn."""
SHIFT_LEAST, SHIFT_WAY = 8, 0.1
"""Fewest states with a shift that tell, and difference of w from 1 up to which places are off by rows."""
SHIFT_ONE_WAY, SHIFT_LEFT = 0.5, 0.5
"""Share of the ways that they may add up to, as on a ramp in one direction another stiffness looks the same; and of the distance
from the own settings' places that may be left. Of 260 tables of robots without a shift none comes near, of those with one nearly
all."""
SHIFT_DELAY = 0.1
"""The same of places that are late in all rows: a lag leaves more."""

OF_MOVED = 0.2
"""Robot lengths, and rad, by which points that a map moved to the model may have been elsewhere: farther than any mount tilts
them, or the sag under the weight is off, so that a body at rest tells nothing."""

# ------------------------------------------------------------------ edits before the diagnosis
EDIT_SD = np.array([10.0, np.log(2), np.radians(30), np.radians(3), np.radians(3), 0.05, 0.05, 0.05])
"""Prior standard deviations of the calibration beside an edit: logarithms of area factor and modulus, rad of azimuth and of
gravity's direction, robot lengths of the origin."""
EDIT_USUAL = np.array([np.log(20), np.log(1.6), np.radians(12), np.radians(4), np.radians(4), 0.03, 0.03, 0.03])
"""Bounds within which the diagnosis' own fit converges; only numbers beyond them are taken over."""
EDIT_USUAL_GAIN = 1.8
"""Factor of one chamber's pressure within which it is an effect: areas differ."""
EDIT_LEAST_TILT = 5.0
"""Degrees of a base or a frame within which the diagnosis names it as an effect."""
EDIT_NEAR_BOUND, EDIT_AT_BOUND = 0.75, 0.98
"""Shares of a bound: above the first edits are tried, above the second the answer says that another number is wrong too."""
EDIT_LOSS_SCALE = 0.01
"""Scale of the robust loss, robot lengths, and the robust rms from which edits are tried."""
EDIT_LOSS_TURN = 0.2
"""The same of attitudes, rad: bodies of markers are stuck on a few degrees off."""
EDIT_REPEATED = 4e-3
"""Robust rms of repeats, robot lengths, from which edits are tried: far more than cameras and re-grown spines scatter."""
EDIT_MODEL_ERROR, EDIT_NOISE = 1.5e-3, 1e-3
"""Robot lengths of robust rms that no edit is asked to go below: models and repeats are no better."""
EDIT_TURN_ERROR, EDIT_ATTITUDES = 0.1, 7
"""rad of attitudes that no edit is asked to go below, and conditions of them that count at most."""
EDIT_CONDITIONS, EDIT_REPEATS = 7, 7
"""Conditions and repeats that count at most in the evidence of edits. Seven: an edit with a prior of a hundredth is sure where it
leaves less than 0.3 of the rms. Laws of another form can look like a modulus or an origin, but do not reduce the gap this far. No
more repeats: near buckling a model scatters by the noise of the pressures that were read. Chosen on two opened robots."""
EDIT_NONE = 0.5
"""Prior share of descriptions that need no edit."""
EDIT_STATED = 0.05
"""Probability from which another edit is stated beside the one that is made."""
EDIT_AS_WELL = 0.9
"""Robust rms over that of the most probable edit below which another of the same kind is made: one number fits no better."""
EDIT_OF_MOVED, EDIT_LEAST, EDIT_GROSS = 0.25, 0.003, 0.02
"""Share of the tip's movement, and its least and largest value in robot lengths, that robust rms, calibrated, must exceed for
edits to be tried at reading: the rest is left to the diagnosis."""
EDIT_UNEXPLAINED, EDIT_FAR = 0.05, 0.5
"""Robot lengths; robust rms above which a table is asked about that no edit explains; median distance from the rod above which
a table in another frame is refused, as nothing can be said of its robot."""
EDIT_STRETCHED, EDIT_STRETCHED_BY = 2.0, 0.1
"""Times as far as the nearest fit, and robot lengths farther, that the tip moves along an axis (sd) whose scale is wrong."""
EDIT_FEWEST = 3
"""States with a tip from which edits are tried."""
EDIT_REFINED, EDIT_FOLLOWED = 7, 3
"""Edits fitted to convergence, and those that others are tried beside."""
EDIT_SAMPLES = 16
"""Tables whose judgement is remembered: each is judged when it is read, and again by what is done with it."""
CONCENTRATED_GAIN, CONCENTRATED_RATIO, FEWEST_CONCENTRATED = 30.0, 2.0, 5
"""Log likelihood that must be gained by two parts of the states with scatters of their own, ratio of these, and fewest states of
one: repeats of a state err alike, so less is found in clean data."""
WALLS_GAIN, LIKELY_WALLS_GAIN, ON_WALLS = 0.3, 0.8, 0.9
"""Shares of the rms with thrust on the cap up to which it is settled, and likely, that the side walls take it: what else acts
hides it. Share on the walls from which they take all of it: less is no convention but an effect."""

# ------------------------------------------------------------------ search: what is followed
FIT_TOLERATED_SIZE, FIT_DISCREPANCY_SIZE = 0.1, 0.25
"""Tolerated size and discrepancy in the fits: the middle of their priors."""
SEARCH_MARGIN, SEARCHED_AT_ONCE = 20.0, 4
"""Log evidence, with that of the prior, below the best hypothesis reached within which the linear problem of another must promise
to lie for it to be searched; hypotheses that are searched in parallel. Chosen on the practice robots."""
UNCONVERGED = 0.5
"""Predicted decrease of the cost above which a search, or a refit to a part of the data, has not converged."""
ONE_SIDED_START = 0.6
"""Share of its scale at which the search for a one-sided effect begins."""
FAR_START = 10.0
"""Times the squared residual of none above which the robot is calibrated anew at a start."""

# ------------------------------------------------------------------ posterior and budget
LEAST_DRAWN = 1e-3
"""Least probability of a candidate of which draws of what effects carry are taken."""
TEMPERATURE = 4.0
"""Divisor of log evidence: laws of another form make readings less independent than the likelihood says. Chosen on the practice
robots."""
BENCHMARK = "checked on sealed robots, docs/explanations/blind.md"
"""How probabilities were checked; shown with every one."""
SIZE_SD_FACTOR = 1.2
"""Factor on the standard deviation of a size in the linear problem. Chosen on the practice robots."""
SIZE_CERTAIN_SD = 1.96
"""Standard deviations from zero beyond which a size is that of a cause: the 95 % interval excludes zero."""
PLACE_FOUND_SD, PLACE_CLEAR_SD, MOST_PLACES = 3.0, 2.0, 2
"""Standard deviations from zero beyond which a relative is at a place, and within which it is not; most places that are named,
where it is at none of the others. Of twelve places one is 3 away by chance in 3 % of all answers."""
LEAST_STATED, LISTED = 0.005, 12
"""Probability below which a table does not list a hypothesis, and a sentence says "< 0.01"; hypotheses in the ranking, besides
none and unknown, which always are."""
CREDIBLE_SHARE = 0.95
"""Probability of the credible set of hypotheses."""
COMPARABLE = 0.4
"""Share of what the largest effect carries that another must carry in a draw to be named with it. Less than the half by which a
score calls an answer right, as an effect that a hypothesis does not name is shrunk towards its tolerance. Chosen on 51 opened
robots, 38 of them pairs."""
OUTSTANDING_FLOORS = 2.0
"""Noise floors that an effect must carry to be named although no hypothesis names it; the definition of "none" in a score."""
TOGETHER = 2 / 3
"""Probability above which effects are named together: naming one too few then costs as much as one too many."""
LEAST_SECOND = 0.1
"""Probability above which an effect is listed among those of which one acts together with what is named."""
RIVAL_PROBABILITY = 0.01
"""Probability below which an effect is no rival."""
COMPARED_DISCREPANCY = 0.25
"""Smallest discrepancy, noise floors, under which effects are compared with each other and experiments are judged."""
TIED = 9.0
"""Chi-square below which two effects cannot be distinguished: three standard deviations."""
UNDETERMINED_SHARE = 0.9
"""Posterior over prior standard deviation of a parameter from which the data are said not to determine it."""
BOUND_SD = 2.0
"""Standard deviations beyond a physical bound at which the data speak against the effect itself."""

# ------------------------------------------------------------------ criticism: outside the catalogue
PREDICTIVE_DISCREPANCY = 0.1
"""Discrepancy, noise floors, that is allowed when readings are predicted from the others."""
TENSE_SD, BEYOND_SD = 4.0, 2.5
"""Standard deviations from its mean at which a tolerance is tense, and those at which others are stated with it."""
HARDLY_APART = 4.0
"""Variance inflation factor above which readings hardly tell a tense tolerance from others: without these its sd would halve."""
OUTSIDE_PROBABILITY = 0.5
"""Probability of a cause outside the catalogue above which the verdict is "unknown"."""
RELATIVE_ODDS = 0.5
"""Prior odds of a relative outside the catalogue against an effect of it: the catalogue holds what is seen most. Chosen on the
practice robots."""
FREE_FORM_ODDS, SAME_ODDS = 0.02, 0.01
"""Prior odds, against what is named, of a stage's error of free form next to it, and of a cause that looks exactly like it.
Chosen on the practice robots."""
SEPARATED_EVIDENCE = 4.0
"""Difference of log evidence by which readings separate a relative from what is named: a factor e of probability."""
USUAL_EXCESS, LARGEST_EXCESS = 2.0, 10.0
"""Factors of excess scatter of repeats, which multiply those odds: less than the first is chance, more than the second counts as
the second."""
LARGEST_ODDS = 7.0
"""Log odds beyond which nothing makes a cause outside the catalogue more probable."""
STAGE_ERROR_SIZES = (0.1, 0.2, 0.4, 0.8)
"""Standard deviations of a stage's free-form error that are tried, plausible sizes of its effects."""
STAGE_GAIN = 8.0
"""Log evidence above which a stage's free-form error is reported. Chosen on the practice robots: laws that differ gain less."""
STAGE_SHARE = 0.8
"""Share of the evidence for free-form errors that one stage must have to be named."""

# ------------------------------------------------------------------ verdict and sentences
CAUSE_PROBABILITY = 0.9
"""Probability above which the answer says "Cause"; below, the robot "behaves most like" one."""
DOUBTED_PROBABILITY = 0.8
"""Largest probability stated of a cause that something speaks against: of sure answers on robots whose laws were not developed
on, before doubts counted, four of five were right."""
FOLLOWED_SHARE = 0.9
"""Share of the reducible gap on unseen states from which effects are named, doubted, though the readings follow no law of theirs
exactly: it is of another form. Chosen on six opened robots: four such effects closed .95 and more, the best effect beside a cause
outside the catalogue .26 and .51."""
LEFT_FLOORS, LEFT_SHARE = 2.0, 0.1
"""Noise floors, and share of the calibrated gap, that a certain cause may leave at most on unseen states, the larger of both."""
NAMED_PROBABILITY = 0.75
"""Probability below which a cause is not named where it is more probable that nothing carries `OUTSTANDING_FLOORS`: a name that
is wrong costs about three times what a small cause costs that is not named, as it sends a person to a part that is sound."""
LIKELY = 0.5
"""Probability below which the headline gives no size of a cause: another is as likely."""
TIE_STATED = 0.1
"""Difference of probability within which the headline names the first two hypotheses, not the first alone."""
OUTSIDE_STATED = 0.01
"""Probability of a cause outside the catalogue above which the statement gives the probability within the catalogue too."""
EXPLAINS = 0.5
"""Share of the reducible gap above which a hypothesis explains it; confirmed where its interval on held-out data is above."""
MORE_THAN_GAP = 1.3
"""Ratio of what an effect moves to the calibrated gap above which the statement explains how it can move more."""
ALIKE_SHARE = 0.5
"""Share of what one actuator differs by from the others below which these are alike, and it is the one that differs."""
CALIBRATION_STATED = 0.01
"""Relative change of the area factor above which the statement says what calibration changed."""
SAME_FACTOR = 0.05
"""Relative difference of two area factors below which they are one: as well as robot.yaml knows its own."""
OTHER_UNIT = 6.0
"""Factor between calibrated and stated stiffness from which a unit or a scale is wrong; psi and kPa differ by 6.9."""
MATERIAL_SD, AREA_SD, GEOMETRY_SD, GAIN_SD = 0.1, 0.1, 1e-4, 0.01
"""What an area factor may stand for: share by which the modulus of rubber differs from batch to batch, where robot.yaml states no
uncertainty; share of the area on which chambers of one design act, from body to body; m of radii of a cast body; share of the
gain of regulators and load cells."""
PRESENT_FLOORS = 0.5
"""Noise floors that an effect must carry to be listed as present."""
REDUCIBLE_RATIO = 1.1
"""Ratio of gap to noise floor below which there is nothing to close."""
FALSE_DISCOVERY_RATE = 0.05
"""Expected share of false alarms among the cells above the noise floor (Benjamini and Hochberg 1995)."""
SMOOTH_SIZES = (0.35, 1.4)
"""Sizes of the smooth function of the step "regular", noise floors; the one that predicts best is taken."""
UNCHANGED = 0.05
"""Probability that nothing changed above which no change is reported."""

# ------------------------------------------------------------------ experiments
RIVAL_WORTH_SEPARATING = 0.02
"""Probability above which an experiment is asked to separate a candidate."""
RIVAL_LEAST_WEIGHT = 0.05
"""Smallest weight of a rival in the expected information, so that experiments also test what the data nearly exclude."""
SEPARATED_BITS = 0.5
"""Expected information above which an experiment separates two candidates."""
OVERHEAD_MIN = 5.0
"""Minutes that each experiment costs besides its own, in bits per minute."""
CERTAIN = 0.95
"""Probability above which `lab investigate` asks for no further experiment."""
LEAST_BITS = 0.05
"""Expected information below which an experiment is not worth doing."""
UNFORESEEN = 1e-3
"""Probability of readings this far off below which a prediction has failed."""
