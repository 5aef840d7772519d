"""Equations of the paper, each a small function with its number, and the chain that they form.

`ranging.locate` imports it, and so does `scanning.stripe_finder` for the methods that use equations as printed.
"""
