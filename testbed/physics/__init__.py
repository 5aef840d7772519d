"""The robot in MuJoCo: its model, walks with real contacts, and how far a map made on them is from the truth.

Needs the extra `sim`; `python -m testbed.physics ROBOT -o FILE` writes a robot folder as an MJCF file.
"""
