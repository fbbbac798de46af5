"""One module a verb of the `lab` command: what it reads, does, prints and returns as exit code. At its end it declares
the verb with its options as `VERBS`; its group and summary are in the table of `lab.cli`.

Nothing but `lab.cli` and other verbs comes in here; what two verbs compute alike lives further down.
"""
