"""Models of MuJoCo through the diagnosis of any model."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import lab
from diagnosis.errors import BadCase

ARM = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <body>
      <joint name="elbow" axis="0 1 0" damping="0.02"/>
      <geom name="link" type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="0.4"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="elbow"/></actuator>
  <sensor><jointpos name="encoder" joint="elbow"/></sensor>
</mujoco>
"""
CAUSES = {
    "dry friction": [("joint", "elbow", "frictionloss", 0.1, "N m")],
    "payload": [("geom", "link", "mass", 0.1, "kg")],
    "gain": [("actuator", "motor", "gainprm[0]", 0.1, "1")],
}


def test_the_field_of_a_mujoco_model_that_is_wrong_is_named() -> None:
    mujoco = pytest.importorskip("mujoco")
    spec = mujoco.MjSpec.from_string(ARM)
    model = lab.mujoco_model(
        spec, {"torque": "motor"}, {"angle": "encoder"}, CAUSES, [("joint", "elbow", "damping", 0.02, "N m s")],
        group="trial", start={"begun": "elbow"},
    )  # fmt: skip
    t = np.arange(0, 1.5, 0.05)
    rng = np.random.default_rng(3)
    trials = pd.concat([
        pd.DataFrame({"trial": k, "t": t, "torque": 0.2 * np.sin((3 + k) * t), "begun": 1.2 + 0.2 * k}) for k in range(3)
    ])  # fmt: skip
    true = {"elbow.damping": 0.03, "elbow.frictionloss": 0.06, "link.mass": 0.4, "motor.gainprm[0]": 1.0}
    angle = model.predict(true, trials)[:, 0] + rng.normal(0, 0.005, len(trials))
    answer = lab.diagnose_model(
        model.predict, trials.assign(angle=angle), {"angle": "rad"}, model.causes, model.calibration, group="trial"
    )
    assert answer.effects == ("dry friction",)
    assert abs(answer.sizes[0].value - 0.06) < 3 * answer.sizes[0].sd
    assert spec.joint("elbow").frictionloss == 0.0  # a person's own model stays as it is
    with pytest.raises(BadCase, match="no sensor 'camera'; the model has encoder"):
        lab.mujoco_model(spec, {"torque": "motor"}, {"angle": "camera"}, CAUSES)
    with pytest.raises(BadCase, match=r"joint 'wrist', damping: is not in the model, which has elbow"):
        lab.mujoco_model(spec, {}, {"angle": "encoder"}, {"drag": [("joint", "wrist", "damping", 0.1, "N m s")]})
