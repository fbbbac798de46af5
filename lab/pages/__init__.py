"""Reports and figures: what people look at. Numbers come in; nothing is computed here but where a line is drawn."""
