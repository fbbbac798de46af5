"""Model criticism: is anything outside the catalogue at work, and are the probabilities calibrated?"""
