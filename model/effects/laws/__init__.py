"""The effects of the catalogue, each law beside its declaration."""
