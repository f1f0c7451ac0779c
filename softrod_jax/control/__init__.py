"""A rod in a control loop: estimating its motion and what acts on it, and predictive control."""
