"""MCAP in and out: messages, writer, reader, replay, and the table of trials.

Writing (one Recorder a run; `push` from any thread):

    recorder = Recorder(path, start_wall_ns=..., attachments={"rig.yaml": b"..."}, metadata={"versions": {...}},
                        chambers=9, markers=3)
    recorder.push("/vacuum", t, absolute=21e3)          fields by name, or one tuple: push("/vacuum", t, (21e3,))
    sink = recorder.sink("/force")                      Callable[[sample], None]: takes attributes named like the fields
    recorder.note_lost("/force", 3)                     samples a driver knows it lost
    recorder.log("info", "text")
    number = recorder.state(t, state)                   what is asked for; `State` holds everything a reading needs
    row = conclude(recorder.buffers, state)             TrialRow, None (not yet), or raises NotSettled
    recorder.trial(t, number, row)                      what was concluded
    counts = recorder.close("completed")                outcome and counts per stream; a `with` block does it too

Reading:

    recording = Recording.open(path)                    .topics .attachments .metadata .log .states .trials
    recording.stream("/tip")["position"]                numpy structured arrays, fields as in messages.py
    table_of(recording) -> Table                        rows as they were concluded live
    replay(path) -> Table                               rows concluded again from the samples; equal to the last bit
    read_csv(path) -> Table; table.write_csv(path)      trials.csv
    info(path) -> Info; export_csv, export_case
"""
