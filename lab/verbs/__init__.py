"""One module per verb of the `lab` command. Each ends with the declaration of the verb and its options, `VERBS`; group and
summary are in the table of `lab.cli`.

Only `lab.cli` and other verbs import from here; code that two verbs share lives further down.
"""
