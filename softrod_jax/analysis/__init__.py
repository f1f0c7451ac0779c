"""What follows from equilibria and their neighbourhood: linear models, modes, inverse problems."""
