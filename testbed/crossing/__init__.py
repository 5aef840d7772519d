"""Crossings: a Go2 in MuJoCo crawls over courses that need sight, by what it was told or saw of them.

`courses` makes the ground, `robot` and `crawl` move the robot by forces, `planner` chooses its steps on a `ground` that
is true, guessed, or seen by `depth_camera` or `laser`, and `walk` counts what came of it. Needs the extras `sim` and
`robots-test`.
"""
