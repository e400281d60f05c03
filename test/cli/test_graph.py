import os

import pytest

from magcal_ros.cli.live_view import use_local_traffic

RANGE, LOCAL_ONLY = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"


@pytest.fixture
def environment(monkeypatch):
    """Give the test an empty environment, and restore the real one."""
    monkeypatch.setattr(os, "environ", {})
    return os.environ


@pytest.mark.parametrize("distribution", ["jazzy", "kilted", "lyrical"])
def test_a_distribution_with_the_new_variable_gets_no_deprecated_one(environment, distribution):
    environment["ROS_DISTRO"] = distribution
    use_local_traffic()
    assert environment[RANGE] == "LOCALHOST"
    assert LOCAL_ONLY not in environment


def test_humble_is_kept_local_by_its_own_variable(environment):
    environment["ROS_DISTRO"] = "humble"
    use_local_traffic()
    assert environment[LOCAL_ONLY] == "1"


def test_the_users_choice_is_kept(environment):
    environment.update(ROS_DISTRO="humble", ROS_LOCALHOST_ONLY="0", ROS_DOMAIN_ID="7")
    environment[RANGE] = "SUBNET"
    use_local_traffic()
    assert (environment[RANGE], environment[LOCAL_ONLY]) == ("SUBNET", "0")
    assert environment["ROS_DOMAIN_ID"] == "7"
