"""The node's benchmark compares a scan with the reference extraction run just before and after it."""

from benchmarks.yardstick import beside


def test_a_scan_is_compared_with_the_reference_before_and_after_it():
    """A machine that becomes three times as slow meanwhile leaves the ratio as it is."""
    lines = beside([0.200, 0.400, 0.600], [0.040, 0.060, 0.140, 0.100], stripes=70)
    assert lines == [
        "the same, min / median / max     200 / 400 / 600 ms",
        "reference, 70 stripes            40.0 / 80.0 / 140.0 ms, before, between and after",
        "scan / reference                 4.00 / 4.00 / 5.00",
        "at the speed at which the reference takes 0.34 ms a stripe: 95 ms per scan",
    ]
