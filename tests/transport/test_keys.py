"""Tests of the keys."""

import pytest

from transport import KeyNameError, keys


def test_keys_are_those_of_the_contract() -> None:
    """Every key stands where users look for it."""
    assert keys.terrain_key() == "guara/perception/v1/terrain"
    assert keys.terrain_key("rex", "map") == "rex/perception/v1/map"
    assert keys.occupancy_key() == "guara/perception/v1/occupancy"
    assert keys.grid_map_key() == "guara/perception/v1/grid_map"
    assert keys.scan_key() == "guara/perception/v1/scan"
    assert keys.query_key() == "guara/perception/v1/query"
    assert keys.status_key() == "guara/perception/v1/status"
    assert keys.alive_key() == "guara/perception/v1/@alive/node"
    assert keys.stance_key() == "guara/gait/v1/stance"


@pytest.mark.parametrize("name", ["", "a/b", "a b", "*", "$x", "@x", "-a", "ä", "a\n"])
def test_a_name_that_is_no_part_of_a_key_is_refused(name: str) -> None:
    """A name with a character that means something in a key is refused, with what is allowed."""
    with pytest.raises(KeyNameError, match="letters, digits"):
        keys.terrain_key(name)


def test_an_unknown_extent_is_refused() -> None:
    """The message lists the extents."""
    with pytest.raises(KeyNameError, match="'footprint', 'map'"):
        keys.terrain_key("guara", "all")
