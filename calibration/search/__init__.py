"""From a start to the best values: optimisers, several starts, robust weights."""
