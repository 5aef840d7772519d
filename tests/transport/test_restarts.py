"""A planner that lives on keeps nothing of the nodes that died."""

from pathlib import Path

import transport


def _shared() -> list[str]:
    return [line for line in Path("/proc/self/maps").read_text().splitlines() if "/dev/shm" in line]


def test_memory_of_dead_nodes_is_released(start, endpoint: str) -> None:
    """After restarts with kill -9, and large grids from each, no shared memory of theirs is mapped."""
    start("router", endpoint)
    with transport.PerceptionClient(transport.open_client(endpoint, timeout=180.0)) as client:
        client.receiver()
        before = len(_shared())
        for number in (1, 2, 3):
            node = start("node", endpoint, "connect")
            node.tell(f"publish {number}")
            client.receive(lambda grid, number=number: grid.sequence == number, timeout=180.0)
            node.kill()
        assert len(_shared()) == before
