"""The adaptive sweep plans its last stripe so that the grid is published before the gait moves on."""

import pytest

import guara_perception as gp
from guara_perception.app.node.sweep import MARGIN_S, Sweeper, SweepJob, Swept
from guara_perception.settings import Settings
from guara_perception.terrain.scan.policy import ScanDecision, ScanPolicy
from kinematics import RobotModel
from tests.guara_perception.app.node.conftest import Rig
from transport import clock

pytestmark = pytest.mark.slow


class Watched(ScanPolicy):
    """Policy that fires no further stripe and stores the time it was offered."""

    time_left: float | None = -1.0

    def decide(self, *_: object, time_left: float | None = None, stripe_time: float = 0.0) -> ScanDecision:  # type: ignore[override]
        self.time_left = time_left
        return ScanDecision("coarse", (), False, ())


@pytest.mark.parametrize(("left", "tail"), [(50.0, 0.0), (50.0, 3.0), (50.0, 60.0), (None, 3.0)])
def test_time_to_process_and_publish_is_left(
    rig: Rig, calibration: gp.Calibration, robot: RobotModel, left: float | None, tail: float
) -> None:
    """Further stripes get the time up to the announced end minus tail and margin; without an announcement, no limit."""
    policy, published = Watched(robot), list[Swept]()
    sweeper = Sweeper(calibration, rig.rangefinder, Settings.of(robot), policy)
    end = clock.now() + (left or 0.0)
    job = SweepJob(
        processor=lambda mode: rig.processor(),
        should_stop=lambda: False,
        publish=published.append,
        ends_at=lambda: None if left is None else end,
        tail=tail,
    )
    swept = sweeper.sweep("adaptive", job)
    if left is None:
        assert policy.time_left is None
    else:
        assert policy.time_left is not None
        assert policy.time_left <= max(end - swept.scan.last_frame - tail - MARGIN_S, 0.0)
    assert swept.terrain.metadata["known"] > 0.5 and not published
