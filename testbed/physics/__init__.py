"""Robots in MuJoCo: models, walks with simulated contacts, and errors of maps made during these walks.

Needs the extra `sim`. `python -m testbed.physics ROBOT -o FILE` writes a robot as an MJCF file.
"""
