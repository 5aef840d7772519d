"""Test bench: scenes and walks with known truth, slow links, emulated devices and physics.

Tests and benchmarks import it. It imports the packages, but not pytest, tests or benchmarks, and is not installed.
"""
