"""The blind bench: sealed cases from a robot whose effects are known to nobody but the seal, diagnosed, then scored.

    make    draws the truth, has the robot measured, writes case folders and the digest of the sealed truth
    run     diagnoses every case; never opens the seal
    score   opens the seal and compares

The robots are those of `worlds`: their physics is not the model's, and the truth states in mm what each effect does.
A set is a folder: commitment.json (public), cases/<id>/ (robot.yaml, trials.csv, menu/), sealed/truth.json, answers/<id>/,
score.json. See docs/howto/blind.md.
"""
