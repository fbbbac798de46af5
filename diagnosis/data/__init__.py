"""From a table of trials to states with their noise components; implausible tables are refused here."""
