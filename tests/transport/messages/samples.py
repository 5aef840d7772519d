"""Messages that the tests of the codec encode."""

import transport

# At the end: "walk-7" and its length, behind a message that ends on four bytes; then, filled up to four bytes, the
# number of standing pauses, and these.
EPOCH_BYTES, FILL_BYTES, STANDING_BYTES = 4 + 7, 1, 4 + 3 * 4


def sample_pause(peer) -> transport.StancePause:
    """The end of a pause, with declared ground."""
    ground = transport.GroundPatch(outline=[[0, 0], [1, 0], [1, 1.5]], height=0.01, sigma=0.002)
    return transport.StancePause(
        robot="guara",
        step=-3,
        phase=transport.PausePhase.END,
        stamp=peer.STAMP + 7,
        stance=peer.make_stance(),
        time_available=2.5,
        known_ground=(ground,),
        epoch="walk-7",
        standing_pauses=(3, 0, 7),
    )


def sample_stream(peer) -> transport.StanceStream:
    """Three samples of two joints and two legs, with an IMU."""
    return transport.StanceStream(
        robot="guara",
        stamp=peer.STAMP + 11,
        sequence=4,
        joint_names=("a", "b"),
        legs=("lf", "rf"),
        times=[0.0, 0.005, 0.0101],
        joint_positions=[[0.1, 0.2], [0.11, 0.19], [0.12, 0.18]],
        supports=[[1, 1], [1, 0], [0, 1]],
        gravity_in_base=[[0, 0, -9.81], [0.1, 0, -9.8], [0.2, 0, -9.8]],
        angular_velocity=[[0.01, 0, 0], [0, 0.02, 0], [0, 0, 0.03]],
        epoch="walk-7",
    )


def sample_status(peer) -> transport.Status:
    """One item that is well and one that is not."""
    items = (
        transport.StatusItem(name="a", level=transport.Health.OK, values={"x": "1", "y_ms": "2.5"}),
        transport.StatusItem(name="b", level=transport.Health.ERROR, message="no", hardware_id="usb"),
    )
    return transport.Status(stamp=peer.STAMP, items=items)
