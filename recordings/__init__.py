"""MCAP in and out: messages, writer, reader, replay, and the table of trials.

Writing (one `file.writer.Recorder` a run; `push` from any thread):

    recorder = Recorder(path, start_wall_ns=..., attachments={"rig.yaml": b"..."}, metadata={"versions": {...}},
                        chambers=9, markers=3)          start_wall_ns: wall time (ns) of rig time 0
    recorder.push("/vacuum", t, absolute=21e3)          fields by name, or one tuple: push("/vacuum", t, (21e3,))
    sink = recorder.sink("/force")                      Callable[[sample], None]: takes attributes named like the fields
    recorder.note_lost("/force", 3)                     samples a driver knows it lost
    recorder.log("info", "text")
    number = recorder.state(t, state)                   what is asked for; `states.rules.State` holds all a reading needs
    row = conclude(recorder.buffers, state)             TrialRow, None (not yet), or raises NotSettled
    recorder.trial(t, number, row)                      what was concluded
    counts = recorder.close("completed")                outcome and counts per stream; a `with` block does it too

Reading:

    recording = file.reader.Recording.open(path)        .topics .attachments .metadata .outcome .log .states .trials
    recording.stream("/tip")["position"]                numpy structured arrays, fields as in messages.py
    campaign.replay.table_of(recording) -> Table        rows as they were concluded live
    campaign.replay.replay(path) -> Table               rows concluded again from the samples
    campaign.replay.compare(recording) -> ReplayComparison    equal to the last bit, or where not
    table_file.read_csv(path), write_csv(table, path)   trials.csv
    campaign.info.info(path), campaign.export.export_streams, campaign.export.export_case
    campaign.info.info(path).clocks, file.clocks.aligned(recording, "/tip")     the instruments' own clocks

Keeping:

    file.verify.verify(path) -> Verification            is every byte what was written
    file.recover.recover(path, target) -> Recovery      all that can be read of a torn or damaged file
    file.journal.Journal, campaign.replay.merged        a run that was broken off, and those that resumed it
    campaign.shelf.runs(folder, where)                  the recordings of a folder tree
"""
