"""Putting a robot's model to use: states in as arrays; tips, shapes, intervals and gradients out, and the way back.

    from model.prediction import Predictor

    at = Predictor(robot)                                  # robot.yaml with its effects
    found = at(pressures, spine_length, intervals=True)    # (n, chambers) Pa, (n,) m
    found.tip, found.orientation, found.sd                 # (n, 3) m, (n, 4), (n, 3) m

Where things are
    predictor   Predictor, Prediction: a view of the forward model for states that are each reached from rest
    campaign    the same of a table, in the order in which its states happened
    inverse     pressures (and spine length) for wanted tips
"""

from model.prediction.predictor import NORMAL_95, Prediction, Predictor

__all__ = ["NORMAL_95", "Prediction", "Predictor"]
