"""A rod that moves while somebody drives it: `softrod view`, and `softrod_jax.view`."""
