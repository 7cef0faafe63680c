"""The benchmark: the DLCC of every policy as a fraction of the optimum."""
