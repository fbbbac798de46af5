"""Reports and figures for people. They receive numbers and compute only the layout."""
