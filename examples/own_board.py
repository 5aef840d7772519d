"""The laser board by hand: home, to an angle, laser on briefly. Here with the emulated board.

    python examples/own_board.py

With a real board leave `backend` out; give other USB ids in `BoardConfig`, or as [board] in devices.toml.
"""

from drivers import BoardConfig, LaserBoard
from drivers.emulator import EmulatedBoard, emulated_backend


def main() -> None:
    """The laser is off when the block is left, even by an exception."""
    with LaserBoard(BoardConfig(), backend=emulated_backend(EmulatedBoard())) as board:
        print(f"ready: {board.ensure_ready()}")
        board.go_to_angle(0.10)
        board.laser_on()
        print(f"lit: {board.status()}")
        board.laser_off()
    print("laser off")


if __name__ == "__main__":
    main()
