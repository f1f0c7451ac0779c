"""How sure the values are: noise, intervals, checks of model, step and grid."""
