"""A node that is its own router and dials another one: planner and gait stay with it, readers elsewhere get it too."""

import pytest

import transport
from tests.ports import free_endpoint


def _client(endpoint: str, robot: str = "guara") -> transport.PerceptionClient:
    return transport.PerceptionClient(transport.open_client(endpoint, timeout=30.0), robot=robot)


@pytest.mark.slow
def test_the_site_comes_and_goes_and_nobody_on_the_robot_notices(start, endpoint: str) -> None:
    """The node starts before its site's router; killed and back, the router gets the newest; the planner every one."""
    site = free_endpoint()
    node = start("node", endpoint, "listen", "", "guara", site)
    with _client(endpoint) as planner:
        node.tell("publish 1")
        assert planner.wait_for_step(1, timeout=30.0).sequence == 1
        router = start("router", site)
        with _client(site) as viewer:
            assert viewer.wait_for_step(1, timeout=30.0).sequence == 1
            assert viewer.request_scan(timeout=30.0).sequence == 1
            router.kill()
            for number in (2, 3, 4):
                node.tell(f"publish {number}")
                assert planner.wait_for_step(number, timeout=30.0).step == number
            start("router", site)
            # What was sent meanwhile may be lost, but for the newest.
            assert viewer.wait_for_step(4, timeout=30.0).step == 4
            node.tell("publish 5")
            assert viewer.wait_for_step(5, timeout=30.0).step == planner.wait_for_step(5, timeout=30.0).step == 5


@pytest.mark.slow
def test_a_link_that_breaks_is_dialled_again(start, slow_link, endpoint: str) -> None:
    """As over radio: the connection is cut while both ends live; the newest arrives by itself when it is back."""
    site = free_endpoint()
    start("router", site)
    link = slow_link(site, 1e8)
    node = start("node", endpoint, "listen", "", "guara", link.endpoint)
    with _client(site) as viewer:
        for number in (1, 3, 5):
            node.tell(f"publish {number}")
            assert viewer.wait_for_step(number, timeout=30.0).step == number
            link.cut()
            node.tell(f"publish {number + 1}")
            assert viewer.wait_for_step(number + 1, timeout=30.0).step == number + 1


@pytest.mark.slow
def test_one_copy_goes_over_the_link_however_many_read(start, slow_link, endpoint: str) -> None:
    """Three readers behind the site's router cost the uplink what one does, and nobody costs it nothing."""
    site = free_endpoint()
    start("router", site)
    link = slow_link(site, 1e8)
    node = start("node", endpoint, "listen", "", "guara", link.endpoint)
    passed = []
    for readers in (0, 1, 3):
        before = link.passed
        clients = [_client(site) for _ in range(readers)]
        local = _client(endpoint)
        for client in (*clients, local):
            client.receiver()
        for number in range(1, 6):
            node.tell(f"publish {10 * readers + number}")
            for client in (*clients, local):
                client.wait_for_step(10 * readers + number, timeout=30.0)
        for client in (*clients, local):
            client.close()
        passed.append(link.passed - before)
    grid = 390_000
    assert passed[0] < grid and 4 * grid < passed[1]
    # Those who come fetch the last grid each for themselves; the five new ones are sent once.
    assert passed[2] < passed[1] + 4 * grid


def test_what_contradicts_or_exposes_is_refused(endpoint: str) -> None:
    """An uplink and `connect` at once; an uplink to another machine without security; an invalid address."""
    with pytest.raises(transport.ConfigurationError, match="mutually exclusive"):
        transport.open_node(connect=endpoint, uplink=endpoint)
    with pytest.raises(transport.ConfigurationError, match=r"'tcp/site\.local:7447' is reachable from other machines"):
        transport.open_node(listen=endpoint, uplink="tcp/site.local:7447")
    with pytest.raises(transport.ConfigurationError, match="is not valid"):
        transport.open_node(listen=endpoint, uplink="site")


@pytest.mark.slow
def test_two_robots_of_one_name_that_meet_later_are_reported(start, endpoint: str, eventually) -> None:
    """Each claims its name while the site is away; when it comes both say so, and readers keep to one of the two."""
    site, other = free_endpoint(), free_endpoint()
    nodes = [start("node", each, "listen", "", "guara", site) for each in (endpoint, other)]
    start("router", site)

    def reported(client: transport.PerceptionClient) -> bool:
        status = client.status()
        item = None if status is None else status.item("name")
        return item is not None and item.level is transport.Health.ERROR and "another node named" in item.message

    with _client(endpoint) as first, _client(other) as second:
        assert eventually(lambda: reported(first) and reported(second))
        nodes[0].kill()
        assert eventually(lambda: not reported(second))
