"""Figures drawn with matplotlib: maps, frames and range images.

Only `app` imports this folder.
"""
