"""Distribution of the tensions of redundant cables: the problems, their compiled solvers, and the
functions that call them."""
