"""Motion in time: schemes, the march through the steps, and their error."""
