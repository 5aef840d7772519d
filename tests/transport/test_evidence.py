"""Which grids may be used: robot, nodes and planner in any order of restarts, losses and pauses, beside the truth."""

import math

import hypothesis.strategies as st
import pytest
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from testbed.restarts import EXTENTS, World
from tests.thorough import examples


class Restarts(RuleBasedStateMachine):
    """Everything that can happen, in any order; the planner asks at every instant."""

    def __init__(self) -> None:
        super().__init__()
        self.world = World()

    @rule(delay=st.sampled_from([0.0, 0.2, 1.0]))
    @precondition(lambda self: self.world.now == 0.0)
    def over_a_link(self, delay: float) -> None:
        self.world.delay = delay

    @rule(seconds=st.sampled_from([0.05, 0.3, 1.0, 2.5, 4.0, 10.0, 60.0]))
    def wait(self, seconds: float) -> None:
        self.world.pass_time(seconds)

    @rule(new_walk=st.sampled_from([False, False, False, True]))
    def begin(self, new_walk: bool) -> None:
        self.world.begin(new_walk=new_walk)

    @rule(moved=st.booleans())
    @precondition(lambda self: self.world.stands)
    def end(self, moved: bool) -> None:
        self.world.end(moved=moved)

    @rule(is_healthy=st.sampled_from([True, True, False]))
    def start(self, is_healthy: bool) -> None:
        self.world.start(is_healthy=is_healthy)

    @rule(times=st.integers(1, 2))
    def scan(self, times: int) -> None:
        for _ in range(times):
            self.world.scan()

    @rule(
        what=st.sampled_from(
            ["kill", "hang", "wake", "cut", "heal", "restart_router", "lose", "mute", "deafen", "listen"]
        )
    )
    def disturb(self, what: str) -> None:
        getattr(self.world, what)()

    @invariant()
    def no_grid_that_the_truth_contradicts(self) -> None:
        for extent in self.world.held:
            found = self.world.against(extent, math.inf)
            if not found:
                assert self.world.contradicted_for(extent) <= self.world.promised(), self.world.held[extent]
            else:
                assert not self.world.must_be_used(extent), found


Restarts.TestCase.settings = settings(max_examples=examples(300), stateful_step_count=40, deadline=None)
TestRestarts = pytest.mark.slow(Restarts.TestCase)


def scanned() -> World:
    """World whose robot stands at its first pause, scanned by its node."""
    world = World()
    world.start()
    world.begin()
    world.scan()
    return world


@pytest.mark.parametrize("extent", EXTENTS)
def test_a_node_that_no_longer_hears_the_gait_vouches_for_nothing(extent: str) -> None:
    """The next pause may have begun unheard; once the gait is heard again, what it said last decides."""
    world = scanned()
    world.end()
    world.pass_time(1.0)
    world.deafen()
    world.pass_time(6.0)
    assert [o.text for o in world.against(extent)] == ["is no longer confirmed: its node has lost the gait controller"]
    world.listen()
    world.pass_time(1.1)
    assert not world.against(extent)
    world.deafen()
    world.begin()
    world.pass_time(6.0)
    world.listen()
    world.pass_time(1.1)
    assert bool(world.against(extent)) == (extent == "footprint")


@pytest.mark.parametrize("extent", EXTENTS)
def test_a_confirmed_grid_is_used_in_the_swings_after_its_pause(extent: str) -> None:
    """From its scan to the next BEGIN; the map beyond."""
    world = scanned()
    world.pass_time(1.0)
    assert world.held[extent].provisional and not world.against(extent)
    world.end()
    world.pass_time(30.0)
    assert not world.held[extent].provisional and not world.against(extent)
    world.begin()
    world.pass_time(0.1)
    assert [o.text for o in world.against(extent)] == (
        ["is 1 pause old; allowed: 0; a footprint grid is valid only during its own pause"]
        if extent == "footprint"
        else []
    )


def test_a_provisional_grid_of_a_dead_node_is_stale_at_once() -> None:
    """END may have been missed: whatever is allowed of its age."""
    world = scanned()
    world.pass_time(0.5)
    world.kill()
    world.pass_time(0.05)
    assert "its node is gone" in world.against("footprint", math.inf)[0].text


@pytest.mark.parametrize("extent", EXTENTS)
def test_a_node_whose_first_token_is_lost_is_gone(extent: str) -> None:
    """The token of its run may be withdrawn a moment later; a planner that already sees no node gets no grid."""
    world = scanned()
    assert not world.against(extent)
    assert [o.text for o in world.against(extent, was_lost=True)] == ["is no longer confirmed: its node is gone"]


def test_a_new_node_does_not_vouch_for_the_ground_of_the_dead_one() -> None:
    """Not on the next pause, not 48 pauses later, not on another walk, and not in the same pause either."""
    world = scanned()
    world.end()
    world.pass_time(0.5)
    world.kill()
    world.pass_time(0.5)
    world.start(is_healthy=False)
    for pauses in (0, 1, 48):
        for _ in range(pauses):
            world.begin()
            world.end()
        world.pass_time(0.5)
        for extent in EXTENTS:
            assert "run 'run-2' has taken over since" in world.against(extent, math.inf)[0].text
    world.begin(new_walk=True)
    world.pass_time(0.5)
    assert world.against("map", math.inf)


def test_a_withdrawal_that_was_missed_is_noticed_by_its_number() -> None:
    """A movement withdrew the confirmed footprint, and the message was lost: the status names a newer one."""
    world = scanned()
    world.pass_time(1.2)
    world.end()
    world.pass_time(0.1)
    held, node = world.held["footprint"], world.node
    assert node is not None and not held.provisional
    node.sequences["footprint"] += 1
    world.pass_time(1.2)
    assert "is not the newest: its node has since published or skipped sequence 3" in world.against("footprint")[0].text


def test_an_age_that_cannot_be_compared_is_too_old() -> None:
    """A caller who computes `max_age` as NaN, or an age that is NaN, gets no old ground for it."""
    world = scanned()
    world.pass_time(0.5)
    assert not world.against("footprint", math.inf)
    assert "allowed: nan s" in world.against("footprint", math.nan)[0].text
