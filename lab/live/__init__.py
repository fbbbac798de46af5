"""A run while it runs: a page in the browser follows its recording, never the run itself.

Where things are
    picture     what the page shows: robot, limits, plan and state, kept up to date from the pieces of the recording; pure
    expected    where the tip should be, by the model, in a process of its own
    viewers     the server: four paths behind a token, and one queue per viewer; slow viewers are disconnected
    foxglove_server  the same to Foxglove and Lichtblick, message by message as they stand in the file
    show        a recording followed or played, and all of it together; `python -m lab.live` is the process beside a run
    page/       the page, and the layout for Foxglove and Lichtblick
"""
