"""Known causes of a gap between model and robot, and the forward model of a whole campaign with all of them in it.

    from model.effects import CATALOGUE, ForwardModel, design_from_columns

    design = design_from_columns(robot, columns)         # columns: trials table, name -> numpy array
    forward = ForwardModel(robot, design, area="one")    # or "per_length"
    y = forward.observe(columns)                         # measured, in the order of forward.observations: row, channel
    theta = np.zeros(len(forward.parameters))            # the baseline: no effect, nothing off
    prediction, jacobian = forward.linearise(theta)      # (n_obs,), (n_obs, n_par)
    forward.linearise(theta, forward.index("contact"))   # the same with a few columns of the derivative, cheaper
    forward.index("base_tilt")                           # columns of one effect (or tolerance) in theta

`forward.parameters` is an ordered tuple of ParameterInfo: name, source (id of the effect), group (effect | calibration
| nuisance), unit, sd (prior, about zero), low, high, sign (both | positive | blend), role (size | shape), starts. An
effect is absent where its sizes are zero; its shapes then do nothing and their columns of the Jacobian are zero, so a
fit that begins at zero should be given a step in the size first, or begin at `starts`.

Where things are
    spec          EffectSpec, Parameter, Law: what an effect is declared as
    catalogue     CATALOGUE, and effects of one's own beside it
    actuation, structure, surroundings, measurement     the effects, each law beside its declaration
    tolerance     calibration of the area and the tolerances that are free under tight priors
    design        States of a campaign from the columns of a table
    quantities    what laws before the rod may change; compose turns it into rods
    history       drive and loading path for laws with memory (friction, relaxation)
    readings      what instruments read; laws after the rod change it
    observation   order of the observations, measured values, noise
    solver        the narrow seam to the rod solver `model.rods`; layout: its rows and results
    forward       ForwardModel
"""

from model.effects.catalogue import CATALOGUE, with_effects
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.effects.spec import EffectSpec, Law, Parameter

__all__ = [
    "CATALOGUE",
    "EffectSpec",
    "ForwardModel",
    "Law",
    "Parameter",
    "design_from_columns",
    "with_effects",
]
