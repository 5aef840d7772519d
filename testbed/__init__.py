"""The test bench: scenes with a truth, walks over known ground, slow links, devices and physics that no robot carries.

Tests and benchmarks import it; it imports the packages, neither pytest nor tests nor benchmarks. It is not installed.
"""
