import os

import pytest

from magcal_ros.cli.live_view import use_local_traffic

RANGE, LOCAL_ONLY = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"


@pytest.fixture
def environment(monkeypatch):
    """Leave the test an environment that says nothing, and put the real one back."""
    monkeypatch.setattr(os, "environ", {})
    return os.environ


@pytest.mark.parametrize("distribution", ["jazzy", "kilted", "lyrical"])
def test_a_distribution_that_knows_the_range_is_not_given_what_it_warns_of(
    environment, distribution
):
    environment["ROS_DISTRO"] = distribution
    use_local_traffic()
    assert environment[RANGE] == "LOCALHOST"
    assert LOCAL_ONLY not in environment


def test_humble_is_kept_on_this_machine_in_its_own_words(environment):
    environment["ROS_DISTRO"] = "humble"
    use_local_traffic()
    assert environment[LOCAL_ONLY] == "1"


def test_what_the_user_chose_stays(environment):
    environment.update(ROS_DISTRO="humble", ROS_LOCALHOST_ONLY="0", ROS_DOMAIN_ID="7")
    environment[RANGE] = "SUBNET"
    use_local_traffic()
    assert (environment[RANGE], environment[LOCAL_ONLY]) == ("SUBNET", "0")
    assert environment["ROS_DOMAIN_ID"] == "7"
