"""Every environment that the package is tested in; `make matrix` runs them one after another.

A Python that this machine lacks is skipped with a word.
"""

from __future__ import annotations

import os
from pathlib import Path

import nox

PYTHONS = ["3.10", "3.11", "3.12", "3.13", "3.14"]

LIBRARIES = {
    "humble": ["numpy==1.21.5", "scipy==1.8.0", "PyYAML==5.4.1", "matplotlib==3.5.1"],
    "lyrical": ["numpy==2.3.*", "scipy==1.16.*"],
}
"""What Ubuntu ships beside the distributions that have no wheels."""

TEST_TOOLS = ["pytest>=6.2.5", "pytest-timeout", "pytest-xdist>=3.5", "hypothesis>=6.36"]
ON_EVERY_CORE = ["--numprocesses", "auto", "--dist", "worksteal"]
PACKAGE = ".[ardupilot,bags,live,px4,report]"
COLCON = "colcon-common-extensions==0.3.0"

nox.options.reuse_venv = "yes"
nox.options.error_on_missing_interpreters = False

# A shim of pyenv is there for each version but runs only the chosen one.
PYENV = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
FOUND = sorted(str(folder) for folder in PYENV.glob("versions/3.*/bin"))
os.environ["PATH"] = os.pathsep.join([*FOUND, os.environ["PATH"]])

os.environ.setdefault("OMP_NUM_THREADS", "1")
# The wheels of ROS start Python anew with their libraries' path: this one's are not the sessions'.
if os.environ.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None):
    os.environ.pop("LD_LIBRARY_PATH", None)


def run_without_ros(session: nox.Session) -> None:
    """Run everything but the tests of the node."""
    session.run("python", "-m", "pytest", *ON_EVERY_CORE, "--ignore", "test/ros", *session.posargs)


@nox.session(python=PYTHONS)
def core(session: nox.Session) -> None:
    """Test what needs no ROS, on the newest libraries."""
    session.install("--editable", PACKAGE, *TEST_TOOLS)
    run_without_ros(session)


@nox.session(python="3.10")
def humble(session: nox.Session) -> None:
    """Test what needs no ROS, on exactly the libraries of Ubuntu 22.04."""
    # This PyYAML has no wheel for Python 3.10, and its build breaks on the newest tools.
    session.install("setuptools<75", "wheel")
    session.install("--no-build-isolation", "PyYAML==5.4.1")
    session.install("--editable", PACKAGE, *TEST_TOOLS, *LIBRARIES["humble"])
    run_without_ros(session)


@nox.session(python=["3.13", "3.14"])
def lyrical(session: nox.Session) -> None:
    """Test what needs no ROS, on the libraries of Ubuntu 26.04."""
    session.install("--editable", PACKAGE, *TEST_TOOLS, *LIBRARIES["lyrical"])
    run_without_ros(session)


# What annotates scipy asks for Python 3.11.
@nox.session(python=PYTHONS[1:])
def types(session: nox.Session) -> None:
    """Check the annotations, on the newest libraries."""
    session.install("--editable", ".[ros,test]")
    session.run("mypy", "--cache-dir", str(Path(session.create_tmp(), "mypy")))


@nox.session(python="3.12")
@nox.parametrize("extra", ["ros", "ros-kilted"], ids=["jazzy", "kilted"])
def ros(session: nox.Session, extra: str) -> None:
    """Run the node's tests and the demo, on the wheels of a distribution."""
    session.install("--editable", f".[bags,live,report,{extra}]", COLCON, *TEST_TOOLS)
    session.run("python", "-m", "pytest", "--numprocesses", "2", "test/ros", *session.posargs)
    session.run("magcal", "demo")


@nox.session(python="3.12")
def docs(session: nox.Session) -> None:
    """Build the site of the pages in doc/; every warning is an error."""
    session.install("--editable", ".[docs]")
    session.run("sphinx-build", "-q", "-W", "doc", str(Path(session.create_tmp(), "site")))


@nox.session(python="3.12")
def package(session: nox.Session) -> None:
    """Build the sdist, the wheel from it, and look at both."""
    session.install("build", "twine")
    folder = session.create_tmp()
    session.run("python", "-m", "build", "--outdir", folder)
    built = sorted(str(path) for path in Path(folder).glob("magcal_ros-*"))
    session.run("twine", "check", "--strict", *built)
