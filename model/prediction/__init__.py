"""Putting a robot's model to use: states in as arrays; tips, shapes, intervals and gradients out, and the way back.

    from model.prediction import Predictor

    at = Predictor(robot)                                  # robot.yaml with its effects
    found = at(pressures, spine_length, intervals=True)    # (n, chambers) Pa, (n,) m
    found.tip, found.orientation, found.sd                 # (n, 3) m, (n, 4), (n, 3) m

Where things are
    states      Design and quantities of states that are each reached from rest
    chain       laws before the rod, the rod, laws with memory, laws after it; derivatives by the chain rule
    predictor   Predictor, Prediction: checked arrays, intervals, gradients, batches on several cores
    inverse     pressures (and spine length) for wanted tips
"""

from model.prediction.predictor import NORMAL_95, Prediction, Predictor

__all__ = ["NORMAL_95", "Prediction", "Predictor"]
