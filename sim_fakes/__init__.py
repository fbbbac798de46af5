"""Fake instruments: one server per instrument on the real wire, and the virtual robot behind them."""
