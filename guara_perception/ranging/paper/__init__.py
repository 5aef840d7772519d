"""The paper's own equations, each one small function with its number, and the chain that they form.

Only `ranging` imports it, and `methods`, which names what of the paper is taken literally.
"""
