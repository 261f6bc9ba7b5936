"""Benchmarks of speed, and the soak run."""
