"""Figures drawn with matplotlib: maps, frames and range images.

Within the package, only `app` imports this folder.
"""
