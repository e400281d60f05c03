"""Builds magcal_ros for pip and, through colcon, for ROS 2 (ament_python)."""

from glob import glob

from setuptools import find_packages, setup

NAME = "magcal_ros"

# Real rclpy as wheels, for machines without ROS. A robot has these from ROS itself.
ROS_WHEELS = [
    "ros-kilted-rclpy==9.1.2",
    "ros-kilted-diagnostic-msgs==5.5.1",
    "ros-kilted-geometry-msgs==5.5.1",
    "ros-kilted-rcl-interfaces==2.3.0",
    "ros-kilted-sensor-msgs==5.5.1",
    "ros-kilted-std-msgs==5.5.1",
    "ros-kilted-std-srvs==5.5.1",
    "ros-kilted-visualization-msgs==5.5.1",
    "ros-rmw-fastrtps-cpp==9.3.3",
]

# Reads bags without ROS.
BAG_READER = ["rosbags>=0.10"]
LIVE_VIEW = ["rich>=12"]

# The first with the model of 2025 to 2030.
WORLD_MAGNETIC_MODEL = ["pygeomag>=1.1"]

REPORT = ["matplotlib>=3.5"]

TEST_TOOLS = [
    "colcon-common-extensions==0.3.0",
    "hypothesis>=6.100",
    "mypy>=1.11",
    "pytest>=8",
    "pytest-timeout>=2.3",
    "pytest-xdist>=3.5",
    "ruff>=0.6",
    "scipy-stubs; python_version >= '3.11'",
    "types-PyYAML",
]

setup(
    name=NAME,
    version="0.1.0",
    description="A compass a ground robot can trust, calibrated by one turn",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*"))),
    ],
    python_requires=">=3.10",
    install_requires=["setuptools", "numpy>=1.21", "scipy>=1.8", "PyYAML>=5.4"],
    extras_require={
        "bags": BAG_READER,
        "live": LIVE_VIEW,
        "report": REPORT,
        "ros": ROS_WHEELS,
        "test": [*BAG_READER, *LIVE_VIEW, *REPORT, *WORLD_MAGNETIC_MODEL, *TEST_TOOLS],
        "wmm": WORLD_MAGNETIC_MODEL,
    },
    zip_safe=True,
    maintainer="magcal_ros maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-cbee3d67.example",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "calibrator = magcal_ros.ros.main:main",
            "magcal = magcal_ros.cli.main:main",
        ]
    },
)
