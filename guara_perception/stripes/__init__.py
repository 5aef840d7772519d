"""Stripe extraction: position of the laser line in every column of a frame, with or without a laser-off frame.

This package imports no other subpackage; `calibration`, `ranging`, `scanning`, `terrain.assessment` and `app` use it.
It does no input or output, except to load its compiled kernel.
"""

from __future__ import annotations

from guara_perception.stripes.band import StripeProfile as StripeProfile
from guara_perception.stripes.band import StripeStatus as StripeStatus
from guara_perception.stripes.extract import METHODS as METHODS
from guara_perception.stripes.extract import extract_stripe as extract_stripe
