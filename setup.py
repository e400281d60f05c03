"""Builds magcal_ros for pip and, through colcon, for ROS 2 (ament_python)."""

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

NAME = "magcal_ros"
MAIL = "magcal-ros@users.noreply.github.com"
HOME = "https://github.com/magcal-ros/magcal_ros"

# Real rclpy as wheels, for machines without ROS. A robot has these from ROS itself.
JAZZY_WHEELS = [
    "ros-jazzy-rclpy==7.1.6",
    "ros-jazzy-builtin-interfaces==2.0.3",
    "ros-jazzy-diagnostic-msgs==5.3.6",
    "ros-jazzy-geometry-msgs==5.3.6",
    "ros-jazzy-nav-msgs==5.3.6",
    "ros-jazzy-rcl-interfaces==2.0.3",
    "ros-jazzy-rmw-fastrtps-cpp==8.4.3",
    "ros-jazzy-rosgraph-msgs==2.0.3",
    "ros-jazzy-sensor-msgs==5.3.6",
    "ros-jazzy-std-msgs==5.3.6",
    "ros-jazzy-std-srvs==5.3.6",
    "ros-jazzy-visualization-msgs==5.3.6",
]
KILTED_WHEELS = [
    "ros-kilted-rclpy==9.1.2",
    "ros-kilted-builtin-interfaces==2.3.0",
    "ros-kilted-diagnostic-msgs==5.5.1",
    "ros-kilted-geometry-msgs==5.5.1",
    "ros-kilted-nav-msgs==5.5.1",
    "ros-kilted-rcl-interfaces==2.3.0",
    "ros-kilted-rmw-fastrtps-cpp==9.3.3",
    "ros-kilted-rosgraph-msgs==2.3.0",
    "ros-kilted-sensor-msgs==5.5.1",
    "ros-kilted-std-msgs==5.5.1",
    "ros-kilted-std-srvs==5.5.1",
    "ros-kilted-visualization-msgs==5.5.1",
]

# Reads bags without ROS.
BAG_READER = ["rosbags>=0.10"]
LIVE_VIEW = ["rich>=12"]

# Reads logs of autopilots.
ARDUPILOT_LOGS = ["pymavlink>=2.4.40"]
PX4_LOGS = ["pyulog>=1.0"]

REPORT = ["matplotlib>=3.5.1"]

DOCS = ["myst-parser>=2", "sphinx>=7"]

# For the tests that need no ROS.
TEST_WITHOUT_ROS = [
    *ARDUPILOT_LOGS,
    *BAG_READER,
    *LIVE_VIEW,
    *PX4_LOGS,
    *REPORT,
    # This and what it needs are plugins of pytest, as pytest-rerunfailures is: workers that start
    # while a plugin is being installed would have one that the controller has not.
    "colcon-common-extensions==0.3.0",
    "hypothesis>=6.100",
    # A second evaluation of the World Magnetic Model to compare with.
    "pygeomag>=1.1",
    "pytest>=8",
    "pytest-rerunfailures>=15",
    "pytest-timeout>=2.3",
    "pytest-xdist>=3.5",
]
TEST_TOOLS = [
    "mypy>=1.11",
    "ruff>=0.6",
    "scipy-stubs; python_version >= '3.11'",
    "types-PyYAML",
]

setup(
    name=NAME,
    version="0.1.0",
    description="Calibrates the magnetometer of a ground robot from one turn",
    long_description=Path(__file__).with_name("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    url=HOME,
    project_urls={"Issues": f"{HOME}/issues", "Changelog": f"{HOME}/blob/main/CHANGELOG.rst"},
    keywords=["ROS", "magnetometer", "compass", "calibration"],
    classifiers=[
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Topic :: Scientific/Engineering",
        "Typing :: Typed",
    ],
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "core/earth_field/coefficients/*.COF", "report/*.css"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*.*"))),
        (f"share/{NAME}/config/sensors", sorted(glob("config/sensors/*.*"))),
        (f"share/{NAME}/launch", sorted(glob("launch/*.*"))),
    ],
    python_requires=">=3.10",
    # The floors are Ubuntu 22.04's: `make matrix` tests on them.
    install_requires=["setuptools", "numpy>=1.21.5", "scipy>=1.8.0", "PyYAML>=5.4.1"],
    extras_require={
        "ardupilot": ARDUPILOT_LOGS,
        "bags": BAG_READER,
        "docs": DOCS,
        "live": LIVE_VIEW,
        "px4": PX4_LOGS,
        "report": REPORT,
        "ros": JAZZY_WHEELS,
        "ros-kilted": KILTED_WHEELS,
        "test-without-ros": TEST_WITHOUT_ROS,
        "test": [*TEST_WITHOUT_ROS, *TEST_TOOLS],
    },
    zip_safe=True,
    author="magcal_ros contributors",
    author_email=MAIL,
    maintainer="magcal_ros maintainers",
    maintainer_email=MAIL,
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "calibrator = magcal_ros.processes:calibrator",
            "magcal = magcal_ros.processes:magcal",
        ]
    },
)
