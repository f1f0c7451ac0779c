"""Annotations are held against every call: the checker that `conftest.py` has packages take."""

from beartype import BeartypeConf, beartype

# A whole number is a float, as for type checkers.
checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
