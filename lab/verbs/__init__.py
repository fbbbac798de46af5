"""One module a verb of the `lab` command: what it reads, does, prints and returns as exit code.

Nothing but `lab.cli`, `lab.blind` and other verbs comes in here; what two verbs compute alike lives further down.
"""
