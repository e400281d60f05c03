"""The command `magcal`: argparse and printing."""

from magcal_ros.threads import use_one

# Here, because every command loads numpy.
use_one()
