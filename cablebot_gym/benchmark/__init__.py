"""The benchmark: every policy's payload as a share of the best found, on the paper's circle and on held-out motions."""
