"""The stripe where its highest peaks do not show it: by its colour, its ridge and its run through all columns.

Imports the files of `stripes` that measure; only `stripes.precise` imports it. It does no input or output.
"""
