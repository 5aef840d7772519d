"""Equations of the paper, each a small function with its number, and the chain that they form.

Used by `ranging.locate`, and by `scanning.stripe_finder` for the methods that take equations as printed.
"""
