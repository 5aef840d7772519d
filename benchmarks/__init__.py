"""Benchmarks: figures of accuracy and speed, printed by commands anyone can run."""
