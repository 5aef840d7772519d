"""Crossings: a robot in MuJoCo crawls over courses that cannot be crossed blindly.

`courses` makes the ground. `eyes` and `laser` model the robot's knowledge of it: complete, none, from a depth camera or
from a laser. `walk` plans and executes the steps and compares them with the truth. Needs the extras `sim` and
`robots-test`.
"""
