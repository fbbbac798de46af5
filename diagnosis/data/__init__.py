"""From a table of trials to states with a noise floor; what cannot be right is refused here."""
