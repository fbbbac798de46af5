"""A run seen while it runs: its recording is followed, never the run itself, and shown on a page in the browser.

Where things are
    about       what a recording says of itself before its first sample: robot, limits, plan
    picture     what the page shows, kept up to date from the pieces of the recording; pure
    feed        pieces of a recording as they come, or at the pace at which they came
    expected    where the tip should be, by the model, in a process of its own
    asking      questions to that process
    http        requests and answers: four paths behind a token, nothing else
    viewers     those who look, each with a queue of its own; who is too slow is let go
    foxglove_server  the same to Foxglove and Lichtblick, message by message as they stand in the file
    show        all of it together, in a process of its own beside a run (`python -m lab.live`)
    page/       the page, and the layout for Foxglove and Lichtblick
"""
