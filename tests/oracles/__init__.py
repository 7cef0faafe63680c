"""Independent models that only tests and benchmarks compare with."""
