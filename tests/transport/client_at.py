"""A planner's client for the transport's tests."""

import transport


def client_at(endpoint: str) -> transport.PerceptionClient:
    """A client that waits for its node however busy the machine is."""
    return transport.PerceptionClient(transport.open_client(endpoint, timeout=180.0))
